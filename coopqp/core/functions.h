/* Functions that the core's files share. The files are one unit, so that the compiler sees all of it. */

#ifndef COOPQP_FUNCTIONS_H
#define COOPQP_FUNCTIONS_H

#include "core.h"
#include "spatial.h"

static inline const ArmJoints &joints_of(const Core *c, int k) { return c->arm_joints[k]; }
/* Numbers of an arm's own joints side by side, `width` of each: where they are, or in `room` if they are not in line. */
static inline const double *side_by_side(const ArmJoints &a, const double *of, int width, double *room) {
    if (a.in_line) return of + width * a.start;
    for (int i = 0; i < a.n; i++) memcpy(room + width * i, of + width * a.own(i), sizeof(double) * (size_t)width);
    return room;
}
/* Where numbers of them are put side by side; `spread` puts these where they belong. */
static inline double *place_for(const ArmJoints &a, double *to, double *room) { return a.in_line ? to + a.start : room; }
static inline void spread(const ArmJoints &a, const double *from, double *to) {
    for (int i = 0; !a.in_line && i < a.n; i++) to[a.own(i)] = from[i];
}
/* The group of arm k; nullptr where it shares no joints. */
static inline const Group *group_of(const Core *c, int k) {
    return c->groups && c->arm_group[k] >= 0.0 ? c->group + (int)c->arm_group[k] : nullptr;
}
/* Of the joints that move the tool of arm k, from the base on: how many are shared, how many there are, and one of them. */
static inline int shared_before(const Core *c, int k) { return joints_of(c, k).shared; }
static inline int joints_behind(const Core *c, int k) { return joints_of(c, k).shared + joints_of(c, k).n; }
static inline int joint_behind(const Core *c, int k, int i) { return joints_of(c, k).joint[i]; }
/* The joints of arm k, or of all of its group. */
static inline int joints_together(const Core *c, int k) {
    return group_of(c, k) ? group_of(c, k)->joints : joints_of(c, k).n;
}
static inline int joint_together(const Core *c, int k, int i) {
    return group_of(c, k) ? group_of(c, k)->joint[i] : joints_of(c, k).own(i);
}
/* Whether arm k stands for all of its group, or for itself. */
static inline bool leads_group(const Core *c, int k) { return !group_of(c, k) || group_of(c, k)->arm[0] == k; }

/* -- kinematics.cpp ------------------------------------------------------------------------------------ */

/* Positions close to these are cheap from now on. */
static void keep_sines(Core *c, const double *positions, double most);
/* O_k: the object as each arm carries it. */
static void carry(const Core *c, const double *positions, Pose *carried);
/* The same and J (6, joints): twist of the object as carried, at the point `about`, in world axes. */
static void carry_and_linearise(const Core *c, const double *positions, const Vector3 &about, Pose *carried,
                                double *jacobian);

/* -- paths.cpp ----------------------------------------------------------------------------------------- */

static int path_pose(Core *c, double clock, Pose &T);
static int path_twist(Core *c, double clock, Ref6 twist);
/* log(T(τ)⁻¹ T(τ + span)) / span */
static int path_increment(Core *c, double clock, double span, const Pose &T, Ref6 twist);
/* Whether the path is a user's, which Python knows. */
static int own_path(const Core *c);
/* Whether the pose of a user's path, or its twist, may jump between two clocks; seek_from and seek_to close in on it by
 * halves. 0 if it does not, or the path fails. */
static int begin_seeking(Core *c, int pose, double from, double to);
static int seeks_on(const Core *c, int pose);
/* Keep the half in which more happens; 0 if the path fails. */
static int go_on_seeking(Core *c, int pose);
/* By how much it jumps before seek_to; 0 if it does not. */
static double found_by_seeking(const Core *c, int pose);
/* First clock after this one at which the twist jumps; the end of the path at the latest. */
static double next_breakpoint(const Core *c, double clock);

/* -- grasps.cpp ---------------------------------------------------------------------------------------- */

/* Whether tools move on the object along the path; the others apply only then. */
static bool grasps_move(const Core *c);
/* The tools are from now on where they are on the object at a clock. */
static void place_grasps(Core *c, double clock, const Twists &shift);
/* The arms that hold the object at a clock have the shares in the common error, and are compared with each other. */
static void take_contact(Core *c, double clock);
/* Whether a change of contact up to a clock is not taken yet. */
static bool contact_changes(const Core *c, double clock);
/* Twist of a tool on the object, in the object frame. */
static Vector6 twist_on_object(const Core *c, int k, double clock);
/* The mean twist of each arm's view of the object over a span, as path_increment: into `own_along`. After that. */
static int grasp_increments(Core *c, double clock, double span);

/* -- ways.cpp ------------------------------------------------------------------------------------------- */

/* From now on arms follow a way of their joints, and not the object, if they do at a clock. */
static void take_ways(Core *c, double clock);
static bool follows_way(const Core *c, int k);
static bool any_follows_way(const Core *c);
/* They carry the object where the first of the others does. */
static void carry_with_others(const Core *c, Pose *carried);

/* -- chain.cpp ----------------------------------------------------------------------------------------- */

/* e_k = log(T⁻¹ O_k); 0 for numbers that are not finite. */
static int errors_at(const Core *c, const Pose *carried, const Pose &T, Twists &errors);
/* Errors of the object as the arms carry it from its reference pose, as commanded or as measured; far off the path they
 * differ by twists, see chain.cpp. 0 where arms differ by nearly half a turn or for numbers that are not finite. */
static int view_errors(const Core *c, const Pose *carried, Twists &errors);
/* Errors after ways are errors + ways + this, of the first view; ways between errors are later - errors + this. */
static Vector6 bend_of_way(const Vector6 &error, const Vector6 &way);
static Vector6 bend_of_errors(const Vector6 &error, const Vector6 &later);
/* ē = Σ W_k e_k */
static Vector6 common_error(const Core *c, const Twists &errors);
/* Joint velocities v0, v1 for world twists about the point of the Jacobian: w0 has one per arm, w1 is common to all unless
 * `own1` has one per arm (6 arms); near the null-space references u0, u1 (nullptr for none). 0 if an arm is singular; the
 * smallest pivots are kept. */
static int two_velocities(Core *c, const double *jacobian, const Twists &w0, const Vector6 &w1, const double *u0,
                          const double *u1, double *v0, double *v1, const double *own1 = nullptr);

/* -- groups.cpp ---------------------------------------------------------------------------------------- */

/* two_velocities of one group; w0 is nullptr for no twist, w1 one for all arms, or with `own` one per arm (6 arms). Velocities
 * and null-space references are of all joints of the cell, of which it reads and writes the group's. 0 if the group is singular; the smallest
 * pivots are kept, 0 where an arm is singular and its group is not. */
static int group_velocities(Core *c, const Group &g, const double *jacobian, const double *w0, const double *w1, bool own,
                            const double *u0, const double *u1, double *v0, double *v1);

/* -- braking.cpp ------------------------------------------------------------------------------------------ */

/* J̇ v of one arm about a point that moves with the object. */
static Vector6 bend(const Core *c, int k, const double *jacobian, const Vector &velocity);

/* -- watch.cpp ----------------------------------------------------------------------------------------- */

/* Compare a sample with the command; lowers watch_cap and sets hold, faults and the reason of the proposal.
 * `positions` are measured, near the commanded ones; `q` is the configuration as measured; `away` is log of the
 * object as measured from as commanded, per arm. */
static void watch_sample(Core *c, const double *positions, const double *q, const Twists &away, double dt);
static void watch_reset(Core *c);

/* -- apart.cpp ----------------------------------------------------------------------------------------- */

/* How far the commands lead the arms apart, and a hold where it is too large. After the errors. */
static void watch_chain(Core *c);
/* Once a step is made. */
static void chain_watched(Core *c);
/* Each tool has moved by exp of its shift (6 arms) from its place, in the object frame; 0 if one is not finite. */
static int move_grasp(Core *c, const double *shift);

/* -- quiet.cpp ----------------------------------------------------------------------------------------- */

/* No further row binds the command, without asking for them. */
static int quiet_step(const Core *c);
/* No further constraint asks for anything ahead at x. */
static int quiet_ahead(const Core *c, const double *x);
/* No further constraint stops the object between the grid point before and one at x, `span` after it. */
static int quiet_node(Core *c, const double *x, const double *slope, const double *curvature, double span);

/* -- preview.cpp --------------------------------------------------------------------------------------- */

/* Start at the commanded positions, on or near the path, and look ahead as far as a step needs; `later`: that is left
 * to the steps. */
static void preview_reset(Core *c, double clock, int later);
/* The first grid point alone, behind `kept` grid points, which stay in the ring: a copy of AHEAD goes on with them. */
static void preview_try(Core *c, double clock, int kept);
/* Some more grid points, with so many Newton steps left: 1 where further ones are needed for a first step to keep to a rate, 0
 * where not; −1 where that is certain not to keep to it. */
static int preview_grow(Core *c, double clock, double rate, int *steps);
/* Largest admissible rate at `clock` for a step of dt; 1 where more than `most` is known to be admissible. The cause of
 * the proposal says what makes it. */
static double preview_cap(Core *c, double clock, double dt, double most);
/* Largest rise of the rate near `clock` by further constraints [1/s]. */
static double preview_rise(const Core *c, double clock, int *joint);
/* D, the fastest fall of the rate near `clock` with which the joints still follow the path [1/s]; it may be negative. */
static double preview_brake(const Core *c, double clock, double dt, double rate);
/* Previewed positions and slopes at `clock`. */
static void preview_reference(Core *c, double clock, double *positions, double *slope);

/* -- posture (chain.cpp) ------------------------------------------------------------------------------- */

/* Velocities that redundant arms ask for at these positions. */
static void posture_velocity(Core *c, const double *positions, double *v);

/* -- step.cpp ------------------------------------------------------------------------------------------ */

/* Distance of two poses [m]; 1 rad counts as TURN_LENGTH. */
static double pose_distance(const Pose &A, const Pose &B);
/* The arms hold in this step: for a reason, with an arm (or an index) and a number. */
static void refuse(Core *c, Reason reason, int index, double a);

/* -- ldp.cpp ------------------------------------------------------------------------------------------- */

/* Least ‖x‖² subject to  low ≤ A x ≤ high  and  lb ≤ x ≤ ub; bounds may be infinite, equal ones make an equality.
 * Rows of A (m, n) should have unit norm. Returns the iterations (≥ 0) and in y (m + n) the multipliers of rows and
 * bounds, positive at an upper one; −1 if no ‖x‖ ≤ reach is feasible: y then proves it; −2 if it gave up, bounds are
 * crossed or numbers are not finite. `work` has room for 2 n (n + 3) numbers. */
static int least_distance(int n, int m, const double *A, const double *low, const double *high, const double *lb,
                          const double *ub, double reach, double *x, double *y, double *work);

#endif
