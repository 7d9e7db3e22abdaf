/* The rate of the one clock of all robots. See drivers/limited_clock.py. */

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "limited_clock.h"

namespace {

/* Rates that are tried in each of two passes where the wanted one breaks a limit. */
constexpr int RATE_CANDIDATES = 32;

/* The step from the last point, and what the limits leave for it and for its change. */
struct Step {
    Curve curve;
    const double *point, *before, *most, *most_change;
    double sigma, period;

    bool keeps_limits(double rate) const {
        double u;
        const double *a = curve.rows((sigma + rate * period) / curve.period, u), w = 1.0 - u;
        const double *b = a + curve.joints + 1, *c = b + curve.joints + 1, *d = c + curve.joints + 1;
        const double of_a = w * w * w / 6.0, of_b = (3.0 * u * u * (u - 2.0) + 4.0) / 6.0;
        const double of_c = (3.0 * w * w * (w - 2.0) + 4.0) / 6.0, of_d = u * u * u / 6.0;
        for (ptrdiff_t j = 0; j < curve.joints; j++) {
            const double value = of_a * a[j] + of_b * b[j] + of_c * c[j] + of_d * d[j];
            const double step = value - point[j], change = step - (point[j] - before[j]);
            if (!(std::abs(step) <= most[j] && std::abs(change) <= most_change[j])) return false;
        }
        return true;
    }
};

/* The rate nearest to the wanted one that keeps the limits; the last one always does. */
double limited_rate(const Step &step, double wanted, double last) {
    double high = wanted, low = last;
    if (step.keeps_limits(high)) return high;
    for (int pass = 0; pass < 2; pass++) {
        const auto rate = [from = low, over = high - low](int k) {
            return from + (1.0 - (double)k / RATE_CANDIDATES) * over;
        };
        int best = 0;
        while (best < RATE_CANDIDATES && !step.keeps_limits(rate(best))) best++;
        high = rate(std::max(best - 1, 0)), low = rate(best);
    }
    return low;
}

} // namespace

double limited_rate(const Curve &curve, const double *point, const double *before, const double *most, const double *most_change,
                    double sigma, double period, double wanted, double last) {
    return limited_rate({curve, point, before, most, most_change, sigma, period}, wanted, last);
}
