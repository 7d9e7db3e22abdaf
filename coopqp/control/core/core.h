/* The compiled step: what its files share. No Python here.
 *
 * The memory is that of layout.py, in three blocks that Python owns: fields are members of Core. Vectors of joints have
 * one number per joint [rad or m]; rotations are row major; twists are [linear; angular].
 *
 *   spatial.h     rotations, logarithm, exponential          kinematics.c  where the arms carry the object, Jacobians
 *   paths.c       pose and twist of the object's path        chain.c       errors, corrections, joint velocities
 *   limits.c      admissible velocities, rates               program.c     the condensed QP and its answer
 *   ldp.c         least-distance programs                    watch.c       supervision, drift, forces
 *   preview.c     the path ahead of the clock                step.c        observe, propose, commit
 */

#ifndef COOPQP_CORE_H
#define COOPQP_CORE_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "layout.h"

/* Unknowns of the condensed QP but for null-space motions: off-path twist, rate, shares of both corrections. */
#define TWIST_AND_SHARES 9

typedef struct Core Core;
struct Core {
    FIELDS
    int arms, joints, nq, unknowns, rows, past; /* rows: further rows that fit; past: samples in `history` */
    int redundant, accelerates;
    int further_rows; /* of this step */
    /* The path: duration, number of breakpoints, number of segments, breakpoints, segments of 21 numbers and in the
     * order of their starts; NULL where own_path knows it. */
    const double *path_numbers;
    double duration;
    /* Calls of what is not known here; 0 if they fail. `out` takes R (9) and p (3), or with `twist` six numbers. */
    int (*own_path)(Core *c, double clock, int twist, double *out);
    /* May lower cap and decrease of a new knot; NULL where nobody does. `slot` is its place in the ring. */
    int (*bound_knot)(Core *c, int slot);
};

/* -- kinematics.c ---------------------------------------------------------------------------------------------------- */

/* O_k: the object as each arm carries it, R (9) then p (3), 12 numbers per arm. */
static void carry(const Core *c, const double *positions, double *carried);
/* The same and Jᵀ (joints, 6): twist of the object as carried, at the point `about`, in world axes. */
static void carry_and_linearise(const Core *c, const double *positions, const double *about, double *carried,
                                double *jacobian);

/* -- paths.c --------------------------------------------------------------------------------------------------------- */

static int path_pose(Core *c, double clock, double *R, double *p);
static int path_twist(Core *c, double clock, double *twist);
/* log(T(τ)⁻¹ T(τ + span)) / span; `R`, `p` is T(τ). */
static int path_increment(Core *c, double clock, double span, const double *R, const double *p, double *twist);
/* First clock after this one at which the twist jumps; the end of the path at the latest. */
static double next_breakpoint(const Core *c, double clock);

/* -- chain.c --------------------------------------------------------------------------------------------------------- */

/* e_k = log(R⁻¹ O_k), 6 per arm; 0 near half a turn or for numbers that are not finite. */
static int errors_at(const Core *c, const double *carried, const double *R, const double *p, double *errors);
/* ē = Σ W_k e_k */
static void common_error(const Core *c, const double *errors, double *common);
/* Joint velocities v0, v1 for world twists about the point of the Jacobian: w0 has one per arm, w1 is common to all; near
 * the null-space wishes u0, u1 (NULL for none). 0 if an arm is singular. */
static int two_velocities(const Core *c, const double *jacobian, const double *w0, const double *w1, const double *u0,
                          const double *u1, double *v0, double *v1);

/* -- watch.c --------------------------------------------------------------------------------------------------------- */

/* Compare a sample with the command; lowers WATCH_CAP and sets HOLD, FAULTS, REASON… of the proposal.
 * `positions` are measured, near the commanded ones; `q` is the configuration as measured; `away` (6 arms) is log of the
 * object as measured from as commanded, per arm. */
static void watch_sample(Core *c, const double *positions, const double *q, const double *away, double dt);
static void watch_reset(Core *c);

/* -- preview.c ------------------------------------------------------------------------------------------------------- */

/* Start at the commanded positions, on or near the path, and look ahead as far as a step needs. */
static void preview_reset(Core *c, double clock);
/* Largest admissible rate at `clock` for a step of dt. CAP_KIND, CAP_ARM, CAP_JOINT of the proposal say what makes it. */
static double preview_cap(Core *c, double clock, double dt);
/* Previewed positions and slopes at `clock`. */
static void preview_reference(Core *c, double clock, double *positions, double *slope);

/* -- posture (chain.c) ----------------------------------------------------------------------------------------------- */

/* Velocities that redundant arms wish for at these positions. */
static void posture_velocity(Core *c, const double *positions, double *v);

/* -- ldp.c ----------------------------------------------------------------------------------------------------------- */

/* Least ‖x‖² subject to  A x = b  (the first `equal` rows) and  low ≤ A x ≤ high  (the others), bounds among the rows.
 * Rows should have unit norm. Returns the iterations (≥ 0), −1 if infeasible, −2 if it gave up.
 * `work` has room for n (3 n + 2 m + 16) numbers. */
static int least_distance(int n, int m, int equal, const double *A, const double *low, const double *high, double *x,
                          double *work);

#endif
