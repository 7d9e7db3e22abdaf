/* The relaxation of forces between N arms, in a memory of its own that Python owns. The scalars are in
 * the struct Minding; control/core/force_memory.py lists the same views. `internal` is the internal wrenches less their target. */

#ifndef COOPQP_MINDING_H
#define COOPQP_MINDING_H

#include "core.h"

/* Numbers of a palm: for friction, then for tilting, A (3, 6) and b (6) of |A w| ≤ b·w; the second b is its normal. */
#define PALM_BOUND 24
#define PALM (2 * PALM_BOUND)

/* What pushes the object, in the world: now, before it moved, and at the last contact; the way back from it, its impulse. */
template <typename V>
struct PushOf {
    V now, before, last, back, impulse;
};
/* Place, velocity and acceleration of the payload. */
template <typename V>
struct TravelOf {
    V place, velocity, acceleration;
};

struct MindingArrays {
    using Square = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;
    Minding *m;                                              /* the scalars */
    double *silent;                                          /* N */
    Twists seen, internal, shift, drift, target, squeezed;   /* wrenches, and twists */
    Square internal_of, yields;                              /* (6 N, 6 N) each */
    double *palms;                                           /* PALM N */
    Twists felt, held, off_servos, off_last, off_step, off_drift; /* see residual.cpp */
    double *off_noise;                                       /* N */
    double *holding, *freed;                                 /* N: arms that hold; how fast the others' grasps come back */
    double *compliances;                                     /* (6 N, 6 N) */
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>> carries; /* (6 N, 3) */
    Square unfed_of;                                         /* (6 N, 6 N) */
    Pose *reference;                                         /* of the object as asked for */
    Vector3 *centre;                                         /* of the payload, in the object */
    TravelOf<Vector3> *travel;
    PushOf<Vector3> *push;
};

static inline MindingArrays minding_of(int arms, Minding *m) {
    const int n = 6 * arms;
    double *at = reinterpret_cast<double *>(m + 1);
    const auto take = [&at](int size) { return (at += size) - size; };
    const auto twists = [&] { return Twists(take(n), 6, arms); };
    const auto square = [&] { return MindingArrays::Square(take(n * n), n, n); };
    return {m, take(arms), twists(), twists(), twists(), twists(), twists(), twists(), square(), square(),
            take(PALM * arms), twists(), twists(), twists(), twists(), twists(), twists(), take(arms),
            take(arms), take(arms), take(n * n), {take(3 * n), n, 3}, square(), reinterpret_cast<Pose *>(take(12)),
            reinterpret_cast<Vector3 *>(take(3)), reinterpret_cast<TravelOf<Vector3> *>(take(9)),
            reinterpret_cast<PushOf<Vector3> *>(take(15))};
}

/* Numbers of the whole memory. */
static inline ptrdiff_t minding_size(ptrdiff_t arms) { return (ptrdiff_t)sizeof(Minding) / 8 + 39 + (94 + PALM) * arms + 144 * arms * arms; }

/* The grasps give way in this step, unless a sensor is silent for too long. */
static inline int gives_way(const Minding *m) {
    return m->stepped != 0.0 && m->stage >= RELAXING && m->sensor_fault == SENSORS_FINE;
}

#endif
