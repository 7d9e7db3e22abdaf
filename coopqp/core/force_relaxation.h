/* The relaxation of forces between N arms, in a memory of its own that Python owns. The scalars are in
 * the struct ForceRelaxation; control/core/force_memory.py has the same views. `internal` is the internal wrenches less their target. */

#ifndef COOPQP_FORCE_RELAXATION_H
#define COOPQP_FORCE_RELAXATION_H

#include "memory.h"
#include "views.h"

/* Stages of a run with forces, in this order. */
enum Stage { CHECKING, PRESSING, RELAXING, MOVING };
/* Readings of the sensors in a step: all came, some did not, one has been missing for too long. */
enum Hearing { HEARD, MISSED, SILENT };
/* A sensor is silent for `sensor_amount` seconds, or reads `sensor_amount` newtons other than the servos' estimate. */
enum SensorFault { SENSORS_FINE, SENSOR_SILENT, SENSOR_WRONG };
/* Why the object may move at `allowed` only; NOTHING_MORE: the operator asks for no more. */
enum Why { NOTHING_MORE, BY_SENSOR, BY_REACH, BY_STAGE, BY_FRICTION, BY_FORCE, BY_CONTACT, BY_RELEASE };

/* Scalars of the relaxation: settings, then state. */
struct ForceRelaxation {
    double wrench_filter;       /* time constant of the filter of wrenches [s] */
    double dead_band;           /* a smaller internal force moves no grasp [N] */
    double relax_time;          /* time constants with which forces decay [s], */
    double drift_time;          /* and with which the motion of the grasps that the path asks for is learned [s] */
    double ramp_time;           /* time in which the grasps begin to move [s] */
    double wrench_silence;      /* a sensor may be silent for so long [s] */
    double most_speed, most_spin, most_reach, most_turn; /* of the grasps [m/s], [rad/s], [m], [rad] */
    double wait_time;                /* forces are small for so long before the object moves [s] */
    double move_below;          /* smaller than this [N], */
    double pressed_below;       /* and of palms than this */
    double force_slows, force_holds; /* an internal force that slows the object, and one that holds it [N] */
    double squeeze, most_squeeze; /* force with which palms press [N], at the start and at most */
    double largest_force;                /* of the largest internal wrench [N]; 1 N m counts as 1 / TURN_LENGTH N */
    double stiffer;             /* ρ, the servos' stiffness over the given one */
    double relax_blend;          /* share of their speed that the grasps have reached */
    double stage_time;               /* time in the stage, or for which forces are small [s] */
    double age;                 /* of the compliances [s] */
    double asked;               /* speed override: the rate that is asked for, */
    double force_cap;           /* that forces allow, */
    double last_rate;           /* and that the last step kept */
    double last_speed;          /* largest joint velocity of the last step [rad/s or m/s] */
    double friction_used;       /* share of a palm's friction in use, filtered */
    double pressed_with, needed; /* force with which palms press, and that the load needs, filtered [N] */
    double sensor_amount;       /* of the fault */
    double allowed;             /* rate at which the object may move now */
    double weight_x, weight_y, weight_z; /* of the payload, in world axes [N] */
    double joint_acceleration;               /* largest acceleration of a joint, filtered and remembered [rad/s² or m/s²] */
    double servo_samples, servo_noise; /* samples that the noise of off_servos is averaged over; it [m] */
    double correction_share;            /* share of the path correction that counts */
    double start_size;          /* `size` before the arms relax, at most [N] */
    double joint_way;            /* way of the joints in the last step [rad or m] */
    double load_mass;           /* of the payload [kg] */
    double contact_limit;       /* a force on the object from here on is a contact [N] */
    double load_acceleration;          /* acceleration of the payload, remembered [m/s²], */
    double touches;             /* for how long it still counts as in contact [s]; 0: it does not */
    double pushed;              /* force on it beside its weight and the arms [N] */
    double sharpest;            /* largest internal force of this sample [N] */
    double asked_dt, reference_dt; /* length of the last step, and of the one before [s] */
    double contact_late;        /* delay after which a contact is felt [s] */
    double retreat_speed, retreat_left, retreat_from; /* retreat: its speed [m/s], way that is left [m], distance where it began [m] */
    double retreats_at;               /* speed of the retreat in this step [m/s] */
    double load_speed;          /* of the payload, remembered [m/s] */
    double look_at;             /* clock from which on Python takes part again [s] */
    Stage stage;
    SensorFault sensor_fault;
    Why why;
    int sensor_arm, why_arm;    /* arm of the fault, and of `why` */
    bool has_palms, rigid;      /* the arms press by palms; their grips are rigid */
    bool saturated;             /* a grasp is at the end of its reach */
    bool stepped;               /* a step has been made */
    bool at_end;                /* the clock stood in the last step */
    bool suspected;             /* an arm is not where its servos should hold it */
    bool goes_on;               /* the operator lets an object go on that met something */
};

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

struct RelaxationArrays {
    using Square = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;
    ForceRelaxation *m;                                              /* the scalars */
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

static inline RelaxationArrays relaxation_of(int arms, ForceRelaxation *m) {
    const int n = 6 * arms;
    double *at = reinterpret_cast<double *>(m) + NUMBERS(ForceRelaxation);
    const auto take = [&at](int size) { return (at += size) - size; };
    const auto twists = [&] { return Twists(take(n), 6, arms); };
    const auto square = [&] { return RelaxationArrays::Square(take(n * n), n, n); };
    return {m, take(arms), twists(), twists(), twists(), twists(), twists(), twists(), square(), square(),
            take(PALM * arms), twists(), twists(), twists(), twists(), twists(), twists(), take(arms),
            take(arms), take(arms), take(n * n), {take(3 * n), n, 3}, square(), reinterpret_cast<Pose *>(take(12)),
            reinterpret_cast<Vector3 *>(take(3)), reinterpret_cast<TravelOf<Vector3> *>(take(9)),
            reinterpret_cast<PushOf<Vector3> *>(take(15))};
}

/* Numbers of the whole memory. */
static inline ptrdiff_t relaxation_size(ptrdiff_t arms) { return (ptrdiff_t)NUMBERS(ForceRelaxation) + 39 + (94 + PALM) * arms + 144 * arms * arms; }

static_assert(std::is_trivially_copyable_v<ForceRelaxation>);

/* The grasps give way in this step, unless a sensor is silent for too long. */
static inline int gives_way(const ForceRelaxation *m) {
    return m->stepped && m->stage >= RELAXING && m->sensor_fault == SENSORS_FINE;
}

#endif
