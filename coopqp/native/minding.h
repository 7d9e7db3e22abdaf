/* The relaxation of forces between N arms, in a memory of its own that Python owns. The scalars are in
 * the struct Minding; relax_plain.py lists the same views. `internal` is the internal wrenches less their target. */

#ifndef COOPQP_MINDING_H
#define COOPQP_MINDING_H

#include "core.h"

/* Numbers of a palm: for friction, then for tilting, A (3, 6) and b (6) of |A w| ≤ b·w; the second b is its normal. */
#define PALM_BOUND 24
#define PALM (2 * PALM_BOUND)

struct MindingArrays {
    Minding *m;                                                        /* the scalars */
    double *silent;                                                    /* N */
    double *seen, *internal, *shift, *drift, *target, *squeezed;       /* 6 N each */
    double *internal_of, *yields;                                      /* (6 N, 6 N) each */
    double *palms;                                                     /* PALM N */
    double *felt, *held, *off_servos, *off_last, *off_step, *off_drift; /* 6 N each; see residual.cpp */
    double *off_noise;                                                 /* N */
    double *compliances;                                               /* (6, 6) N */
    double *carries;                                                   /* (6 N, 3) */
    double *unfed_of;                                                  /* (6 N, 6 N) */
    double *reference;                                                 /* 12: R and p of the object as asked for */
    double *centre;                                                    /* 3: of the payload, in the object */
    double *travel;                                                    /* its place, velocity and acceleration, 3 each */
    double *push;                                                      /* 3 now, 3 before it moved, 3 of the last contact, the way back from it, the impulse; see contact() */
};

static inline MindingArrays minding_of(int arms, Minding *m) {
    const int n = 6 * arms;
    MindingArrays f;
    f.m = m;
    f.silent = reinterpret_cast<double *>(m + 1);
    f.seen = f.silent + arms, f.internal = f.seen + n, f.shift = f.internal + n, f.drift = f.shift + n;
    f.target = f.drift + n, f.squeezed = f.target + n;
    f.internal_of = f.squeezed + n, f.yields = f.internal_of + (size_t)n * (size_t)n;
    f.palms = f.yields + (size_t)n * (size_t)n;
    f.felt = f.palms + PALM * arms, f.held = f.felt + n, f.off_servos = f.held + n, f.off_last = f.off_servos + n;
    f.off_step = f.off_last + n, f.off_drift = f.off_step + n, f.off_noise = f.off_drift + n, f.compliances = f.off_noise + arms;
    f.carries = f.compliances + 6 * n, f.unfed_of = f.carries + 3 * n;
    f.reference = f.unfed_of + (size_t)n * (size_t)n, f.centre = f.reference + 12, f.travel = f.centre + 3, f.push = f.travel + 9;
    return f;
}

/* Numbers of the whole memory. */
static inline ptrdiff_t minding_size(ptrdiff_t arms) { return (ptrdiff_t)sizeof(Minding) / 8 + 39 + (128 + PALM) * arms + 108 * arms * arms; }

/* The grasps give way in this step, unless a sensor is silent for too long. */
static inline int gives_way(const Minding *m) {
    return m->stepped != 0.0 && m->stage >= RELAXING && m->sensor_fault == SENSORS_FINE;
}

#endif
