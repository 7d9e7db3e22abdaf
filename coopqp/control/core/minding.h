/* The relaxation of forces between N arms, in a memory of its own that Python owns. The scalars are in
 * layout.MINDING; relax_plain.py lists the same views. `internal` is the internal wrenches less their target. */

#ifndef COOPQP_MINDING_H
#define COOPQP_MINDING_H

#include "core.h"

/* Numbers of a palm: for friction, then for tilting, A (3, 6) and b (6) of |A w| ≤ b·w; the second b is its normal. */
#define PALM_BOUND 24
#define PALM (2 * PALM_BOUND)

typedef struct {
    double *m;                                                         /* the scalars */
    double *silent;                                                    /* N */
    double *seen, *internal, *shift, *drift, *target, *squeezed;       /* 6 N each */
    double *internal_of, *yields;                                      /* (6 N, 6 N) each */
    double *palms;                                                     /* PALM N */
} Minding;

static inline Minding minding_of(int arms, double *memory) {
    const int n = 6 * arms;
    Minding f;
    f.m = memory;
    f.silent = memory + N_MINDING;
    f.seen = f.silent + arms, f.internal = f.seen + n, f.shift = f.internal + n, f.drift = f.shift + n;
    f.target = f.drift + n, f.squeezed = f.target + n;
    f.internal_of = f.squeezed + n, f.yields = f.internal_of + (size_t)n * (size_t)n;
    f.palms = f.yields + (size_t)n * (size_t)n;
    return f;
}

/* Numbers of the whole memory. */
static inline ptrdiff_t minding_size(ptrdiff_t arms) { return N_MINDING + (37 + PALM) * arms + 72 * arms * arms; }

/* The grasps give way in this step, unless a sensor is silent for too long. */
static inline int gives_way(const double *m) {
    return m[STEPPED] != 0.0 && m[STAGE] >= RELAXING && m[SENSOR_FAULT] == SENSORS_FINE;
}

#endif
