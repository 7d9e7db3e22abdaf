/* The rate of the one clock of all robots. See drivers/limited_clock.py. */

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "binding/arrays.h"

namespace {

/* Rates that are tried in each of two passes where the wanted one breaks a limit. */
constexpr int RATE_CANDIDATES = 32;

/* Control points of the commands' curve, in a ring that is kept twice: `size` rows of n numbers and the clock. */
struct Curve {
    const double *points;
    Py_ssize_t count, size, joints;
    double period;

    /* The first of the four rows that matter at s periods, and the share of the way from the second to the third. */
    const double *rows(double s, double &share) const {
        const double oldest = (double)std::max<Py_ssize_t>(0, count - size), newest = (double)(count - 4);
        const double whole = std::floor(s); /* or NaN, which is no place in memory */
        const Py_ssize_t i = (Py_ssize_t)(whole > oldest ? std::min(whole, newest) : oldest);
        share = std::min(std::max(s - (double)i, 0.0), 1.0);
        return points + i % size * (joints + 1);
    }
};

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
        for (Py_ssize_t j = 0; j < curve.joints; j++) {
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

/* limited_rate(points, count, period of the commands, point, point before, most, most change, sigma, period, wanted, last) */
double limited_rate_of(const In &points, Py_ssize_t count, double every, const In &point, const In &before, const In &most,
                       const In &most_change, double sigma, double period, double wanted, double last) {
    const Py_ssize_t n = point.size, rows = points.length(0);
    check_fit(points.length(1) == n + 1 && rows >= 8 && count >= 4 && before.size == n && most.size == n &&
              most_change.size == n);
    const Curve curve = {points.data, count, rows / 2, n, every};
    return limited_rate({curve, point.data, before.data, most.data, most_change.data, sigma, period}, wanted, last);
}

} // namespace

void bind_clock(nb::module_ &m) { m.def("limited_rate", limited_rate_of); }
