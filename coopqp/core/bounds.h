/* Lower bounds of distances that follow the joints, and rows that keep distances. Reaches are (nv, P): the pairs of one
 * joint stand in a row, for the processor's vectors. */

#ifndef COOPQP_BOUNDS_H
#define COOPQP_BOUNDS_H

#include <math.h>
#include <stddef.h>

#include "spatial.h"

#define LANES 8
#define TURN 6.283185307179586

/* Clearances shrink by the most that the joints' way can take. */
static inline void follow(double *clearances, const double *reach, double *positions, const double *x, const double *continuous,
                   ptrdiff_t pairs, ptrdiff_t joints) {
    for (ptrdiff_t j = 0; j < joints; j++) {
        const double *own = reach + j * pairs;
        double way = fabs(x[j] - positions[j]);
        if (continuous[j] != 0.0 && fabs(TURN - way) < way) way = fabs(TURN - way);
        positions[j] = x[j];
        if (way != 0.0)
            for (ptrdiff_t k = 0; k < pairs; k++) clearances[k] -= own[k] * way;
    }
}

/* Largest reach over clearance, per joint; 0 if a clearance is not positive. `shares` is memory for one number per pair. */
static inline int certify(const double *clearances, const double *reach, double spare, double *shares, double *out,
                   ptrdiff_t pairs, ptrdiff_t joints) {
    for (ptrdiff_t j = 0; j < joints; j++) out[j] = 0.0;
    for (ptrdiff_t k = 0; k < pairs; k++) {
        if (!(clearances[k] > spare)) return 0;
        shares[k] = 1.0 / (clearances[k] - spare);
    }
    for (ptrdiff_t j = 0; j < joints; j++) {
        const double *own = reach + j * pairs;
        double most[LANES] = {0.0};
        for (ptrdiff_t k = 0; k < pairs; k += LANES) {
            const int some = pairs - k < LANES ? (int)(pairs - k) : LANES;
            for (int l = 0; l < some; l++) {
                const double share = own[k + l] * shares[k + l];
                most[l] = share > most[l] ? share : most[l];
            }
        }
        for (int l = 0; l < LANES; l++) out[j] = most[l] > out[j] ? most[l] : out[j];
    }
    return 1;
}

/* G (joints) of a pair with unit normal and point in `ends` (6), by the joints' world Jacobians J (joints, 6). */
static inline void gradient(const double *ends, const double *J, const double *kinds, double *G, ptrdiff_t joints) {
    const Eigen::Map<const Vector3> n(ends), p(ends + 3);
    const Vector6 at_origin = both(n, p.cross(n));
    for (ptrdiff_t j = 0; j < joints; j++) G[j] = kinds[j] * at_origin.dot(Eigen::Map<const Vector6>(J + 6 * j));
}

/* The pair whose clearance, at least `least`, may be used up first: `most` is what a unit of motion takes. -1 of none. */
static inline ptrdiff_t soonest(const double *clearances, const double *most, double least, ptrdiff_t pairs) {
    double share = -1.0;
    ptrdiff_t found = -1;
    for (ptrdiff_t k = 0; k < pairs; k++) {
        const double clearance = clearances[k] > least ? clearances[k] : least;
        if (most[k] > share * clearance) share = most[k] / clearance, found = k;
    }
    return found;
}

/* Whether joints at speeds up to `most` can break a row G v >= lower. */
static inline int breakable(const double *G, double lower, const double *most, ptrdiff_t joints) {
    double fastest = 0.0;
    for (ptrdiff_t j = 0; j < joints; j++) fastest += fabs(G[j]) * most[j];
    return fastest > -lower;
}

/* What d' >= -approach clearance asks of a pair. */
static inline double least_speed(double clearance, double approach) { return clearance > 0.0 ? -clearance * approach : 0.0; }

#endif
