/* The compiled step: what its files share. No Python here.
 *
 * memory.h lists the memory, three blocks in one piece that each Core owns: fields are members of Core, seen as
 * Eigen's vectors and matrices (views.h). Vectors of joints have one number per joint [rad or m]; twists are [linear; angular].
 * Sizes inside a step are fixed or bounded: nothing of it is on the heap, and each build has Eigen under a name of its own.
 *
 *   spatial.h        poses, logarithm, exponential           frames.h         joint frames of an arm, with
 *                                                            kinematics.cpp where the arms carry the object, Jacobians
 *   grasps.cpp       tools that move on the object          ways.cpp         arms that follow ways of their joints
 *   paths.cpp        pose and twist of the object's path     chain.cpp        errors, corrections, joint velocities
 *   limits.cpp       admissible velocities, rates            program.cpp      the condensed QP and its answer
 *   ldp.cpp          least-distance programs                 watch.cpp        supervision, drift, forces
 *   apart.cpp        arms that their commands part           groups.cpp       arms that share joints, as one arm
 *   braking.cpp      rows that brake all arms together where nothing is known ahead
 *   self_motion.cpp  what self-motion costs where limits bind
 *   preview.cpp      the path ahead of the clock, with       step.cpp         observe, propose, commit
 *     horizon.cpp      grid points, the largest rate at each         growth.cpp       more of them, one Newton step at a time
 *     sharing.cpp      programs of the accelerations           chain_ahead.cpp  the chain at one clock
 *     redundancy.cpp   self-motion at position limits        servo.cpp        new targets
 *     quiet.cpp        where further constraints are quiet
 *   force_relaxation.h        forces between the arms, with           relax.cpp        wrenches, and grasps that give way
 *     allow.cpp        how fast the object may move for them
 */

#ifndef COOPQP_CORE_H
#define COOPQP_CORE_H

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include <algorithm>
#include <utility>

#include "memory.h"
#include "force_relaxation.h"
#include "views.h"

/* Unknowns of the condensed QP but for null-space motions: off-path twist, rate, shares of both corrections. */
#define TWIST_AND_SHARES 9

/* Whether no row can bind; how many rows there are; whether the command has made them tighter; to look around; whether arms
 * that attach are where they grasp. */
enum Question { ASK_CLEAR, ASK_ROWS, ASK_TIGHTER, ASK_SURVEY, ASK_CONTACT };

/* The joints that move the tool of an arm, from the base on: those that it shares, then its own. */
struct ArmJoints {
    int shared, n;  /* how many it shares, and has of its own */
    int start;      /* its first own joint; */
    bool in_line;   /* the others follow it: no joint that moves no tool stands between them */
    int joint[MOST_JOINTS];

    int own(int i) const { return joint[shared + i]; }
};

/* Arms that share joints: one redundant arm. */
struct Group {
    int arms, shared, joints; /* joints: the shared ones and all arms' own */
    bool in_line, by_arms;    /* each shared joint moves all tools; the group may be inverted arm by arm */
    int arm[MOST_SHARING];
    int joint[MOST_GROUP_JOINTS]; /* the shared ones, then each arm's own */
    bool moves[MOST_SHARING][MOST_GROUP_JOINTS]; /* whether each shared joint moves the tool of each arm */
};

struct Core {
    Core() = default;
    Core(const Core &) = delete; /* views are of its own memory */
#define MEMBER(type, name, size) type name;
    CONFIG_FIELDS(MEMBER)
    STATE_FIELDS(MEMBER)
    WORK_FIELDS(MEMBER)
#undef MEMBER
    int arms = 0, joints = 0, nq = 0, unknowns = 0, rows = 0, past = 0; /* rows: further rows that fit; past: samples in `history` */
    int redundant = 0, few = 0, looks_ahead = 0; /* few: some arm has fewer than six joints */
    const ArmJoints *arm_joints = nullptr;
    int groups = 0; /* of arms that share joints */
    const Group *group = nullptr;
    int users_path = 0; /* the path is no one of the library: it may jump or bend where no breakpoint tells */
    int given_rows = 0, further_rows = 0; /* of this step: by constraints, and with those that brake all arms together */
    bool asks_rows = false; /* constraints have rows */
    bool contact_due = false, was_drifted = false; /* a change of contact is not taken yet; measurements had come before it */
    int node_asked = 0, surveyed = 0; /* in this step: what bodies bound at a grid point, a piece of what they ask for ahead */
    int asked = 0;        /* how often a user's path was asked for what is ahead */
    /* The path: duration, number of breakpoints, number of segments, breakpoints, segments of 29 numbers in the order of
     * their starts. A path without segments is known to own_path. */
    const double *path_numbers = nullptr;
    double duration = 0.0;
    const double *shifts = nullptr; /* of the path, in their order: SHIFT numbers each, see paths.cpp */
    int shift_count = 0;
    const double *grasp_numbers = nullptr; /* how the tools move on the object, see grasps.cpp; nullptr where they are fixed */
    ForceRelaxation *relaxation = nullptr; /* of the forces between the arms, see force_relaxation.h; nullptr where nobody relaxes them */
    /* Calls into Python; 0 if they fail. The pose comes into `own_pose`, or with `twist` six numbers. */
    int (*own_path)(Core *c, double clock, int twist) = nullptr;
    /* May lower cap and decrease of a new grid point; nullptr for none. `slot` is its place in the ring. */
    int (*bound_node)(Core *c, int slot) = nullptr;
    /* May add self-motion to `evading_slope` at `evading_positions`; nullptr for none. 0 if it fails. */
    int (*evade)(Core *c) = nullptr;
    /* Another solver answers the QP whose base and columns are filled in, into `x` and `pull`; 0 if it has no answer. */
    int (*solve)(Core *c, int relax) = nullptr;
    int width = 0; /* columns of the QP: of its unknowns, and of those by which the chain may part */
    /* Asks further constraints, whose rows go into the memory: one that fails makes the step hold. */
    long (*ask)(Core *c, Question question) = nullptr;
    /* Does a piece of what bodies ask for where the next grid point is expected, in `evading_positions`, with the slope of the
     * last one in `evading_slope`; nullptr for none. 0 if there is nothing to do. */
    int (*survey_ahead)(Core *c) = nullptr;
};

/* Something is known ahead of a step. */
static inline bool sees(const Core *c) { return c->looks_ahead && !c->ahead->blind; }

/* Some joint has an acceleration limit. */
static inline bool accelerates(const Core *c) { return c->options->accelerates; }

/* Rows that constraints may give; those that brake all arms together come after them. */
static inline long most_given(const Core *c) { return c->rows - (1 + c->arms + c->joints); }

/* The vectors of a record. */
static inline double *vectors_of(Record *record) { return reinterpret_cast<double *>(record + 1); }

/* The core's functions, once for any processor and once for a newer one; see step.cpp and kinematics.cpp. */
struct Arithmetic {
    void (*start)(Core *c, const double *positions);
    void (*start_path)(Core *c, double clock, double rate);
    void (*observe)(Core *c, const double *q, const double *dt);
    Outcome (*propose)(Core *c);
    Status (*commit)(Core *c);
    double (*try_step)(Core *c);
    int (*jumps)(const Core *c, const double *velocity);
    int (*move_grasp)(Core *c, const double *shift);
    void (*relax_before_step)(Core *c, const double *wrenches, double dt);
    void (*relax_after_step)(Core *c);
    void (*linearise)(const Core *c, const double *positions, const Vector3 &about, Pose *carried, double *jacobian);
    int (*least_distance)(int n, int m, const double *A, const double *low, const double *high, const double *lb,
                          const double *ub, double reach, double *x, double *y, double *work);
    /* Retarget to the way to a new target if the rate of its first step need not fall, or where the object rests: 1, with
     * the path in `numbers`; 0 if not yet. `rate` is the largest one asked for. */
    int (*retarget)(Core *c, const double *goal, double speed, double spin, double rate, double *numbers);
    /* The relaxation of forces, in its own memory; see relax.cpp and allow.cpp. `wrenches` may be nullptr. */
    Hearing (*relax)(int arms, ForceRelaxation *m, const double *wrenches, double dt);
    void (*allow)(int arms, ForceRelaxation *m, double dt);
};

namespace plain {
extern const Arithmetic arithmetic;
}
namespace avx2 {
extern const Arithmetic arithmetic;
}

/* The best arithmetic that this processor can do. */
inline const Arithmetic *best() {
#ifdef HAS_AVX2_ARITHMETIC
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return &avx2::arithmetic;
#endif
    return &plain::arithmetic;
}

#endif
