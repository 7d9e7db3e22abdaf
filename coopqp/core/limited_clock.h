#ifndef COOPQP_LIMITED_CLOCK_H
#define COOPQP_LIMITED_CLOCK_H

#include <stddef.h>

#include <algorithm>
#include <cmath>

/* Control points of the commands' curve, in a ring that is kept twice: `size` rows of n numbers and the clock. */
struct Curve {
    const double *points;
    ptrdiff_t count, size, joints;
    double period;

    /* The first of the four rows that matter at s periods, and the share of the way from the second to the third. */
    const double *rows(double s, double &share) const {
        const double oldest = (double)std::max<ptrdiff_t>(0, count - size), newest = (double)(count - 4);
        const double whole = std::floor(s); /* or NaN, which is no place in memory */
        const ptrdiff_t i = (ptrdiff_t)(whole > oldest ? std::min(whole, newest) : oldest);
        share = std::min(std::max(s - (double)i, 0.0), 1.0);
        return points + i % size * (joints + 1);
    }
};

/* The rate of the clock nearest to the wanted one that keeps the limits of each joint: the step from the last point, and the
 * change from the one before; the last rate always does. */
double limited_rate(const Curve &curve, const double *point, const double *before, const double *most, const double *most_change,
                    double sigma, double period, double wanted, double last);

#endif
