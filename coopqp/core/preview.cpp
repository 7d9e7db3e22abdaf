/* The path ahead of the object's clock: where limits and singularities bind, and how fast the object may go.
 *
 * Under acceleration limits no single step can keep both the chain and the path at a limit: all arms have to brake
 * together, ahead of it. The preview runs the chain's own inverse kinematics ahead of the clock, grid point by grid point, and
 * stores the joints' derivatives with respect to the clock, q′ = A⁻¹ν and q″. With rate σ the joints move at q′σ and
 * accelerate at q′σ̇ + q″σ². Speeds bound z = σ² at each grid point. A backward pass over the grid points finds K, the largest z
 * from which the object can go on within the accelerations (sharing.cpp), down to a stop at the end of the known
 * horizon. The rate of a step keeps σ² ≤ K in its middle and at its end. It is path timing on a rolling horizon: as long
 * as the object needs to stop, and no longer. */

#include "ahead.h"

constexpr int STEPS_TO_GROW = 8; /* a grid point is begun this many steps before it is needed */
constexpr int LEAST_ASKED = 4; /* a user's path is asked up to this often in a step for what is ahead, */
constexpr double ASKED_PER_TIME = 6000.0; /* and more often in steps [1/s] */
constexpr double SHORT_STEP = 0.002; /* that are longer than this [s], */
constexpr int STEPS_TO_ASK = 40; /* and a grid point of it is begun this many steps before it is needed */

/* Pieces of work on bodies ahead that a start does at most. */
#define SURVEYS_AT_START 20

/* The look-ahead finds a grid point with the grasps as they are when it is begun: grasps that go on giving way would be pursued
 * by its Newton steps for ever. */
static void take_grasps(Core *c) {
    std::copy(c->object, c->object + c->arms, c->ahead_object);
    c->ahead_shift = c->grasp_shift;
}

/* Swaps these grasps with the present ones; a second call swaps them back. */
static void swap_grasps(Core *c) {
    std::swap(c->object, c->ahead_object);
    if (grasps_move(c)) c->own_way.swap(c->ahead_own_way);
}

/* While the look-ahead fails the arms hold. */
static void hold_blind(Core *c) {
    if (c->proposal->watch_cap > 0.0) refuse(c, LOOK_AHEAD_FAILED, -1, c->loop->clock);
}

/* Whether K is final along a step. */
static int is_final(const Core *c, double clock, double dt) { return c->ahead->complete || reaches(c, clock, dt); }

/* Grow the horizon until it reaches far enough, or admits a rate, or by that many Newton steps, or questions to a user's
 * path. */
static void extend_horizon(Core *c, double clock, double dt, double rate, int newton_steps, double most_asked) {
    c->asked = 0;
    for (int i = 0; i < newton_steps; i++) {
        leave_behind(c, clock);
        if (is_final(c, clock, dt) || admits_rate(c, clock, dt, rate) || c->asked >= most_asked) return;
        const int grown = work_ahead(c);
        if (grown < 0) hold_blind(c);
        if (grown <= 0) return;
    }
}

/* A grid point is begun this many steps before it is needed. */
static double steps_to_grow(const Core *c) { return own_path(c) || c->bound_node ? STEPS_TO_ASK : STEPS_TO_GROW; }

/* A piece of work before it is needed: on bodies ahead, else on the next grid point. */
static void work_early(Core *c) {
    if (!survey_ahead(c)) work_ahead(c);
}

/* How often a user's path is asked in a step for what is ahead. */
static double most_asked(const Core *c) {
    return own_path(c) ? LEAST_ASKED + maximum(0.0, floor(ASKED_PER_TIME * (c->options->nominal_dt - SHORT_STEP))) : INFINITY;
}

/* The cap of a step, from a horizon that is grown for it, and the grid point that makes it; −1 if none does, or if more than
 * `most` is admitted before K is final. */
static double cap_on_horizon(Core *c, double clock, double dt, double most, int *cause) {
    Ahead *a = c->ahead;
    Least least = least_square(c, clock, 1.0, dt);
    *cause = -1;
    if (least.square >= 1.0) {
        a->free_until = free_until(c, 2.0 * maximum(dt, c->options->nominal_dt));
        a->grow_from = a->free_until - steps_to_grow(c) * c->options->nominal_dt;
        return 1.0;
    }
    if (!is_final(c, clock, dt) && admits_rate(c, clock, dt, most)) return 1.0;
    const double rate = largest_rate(c, clock, dt, &least);
    *cause = least.cause;
    a->ends_in_stop = node(c, *cause)->stops;
    return rate;
}

static void preview_try(Core *c, double clock, int kept) {
    take_grasps(c);
    swap_grasps(c);
    const int head = kept ? place_of(c, kept) : 0;
    *c->ahead = Ahead();
    c->ahead->head = head, c->ahead->kept = kept;
    c->ahead->free_until = -INFINITY;
    c->ahead->grow_from = INFINITY;
    if (first_node(c, clock)) push_node(c);
    swap_grasps(c);
}

static int preview_grow(Core *c, double clock, double rate, int *steps) {
    const double dt = c->options->nominal_dt, begun = c->ahead->count;
    int open = begun > 0.0, failed = 0;
    c->asked = 0;
    swap_grasps(c);
    for (; open && *steps > 0; --*steps) {
        open = !is_final(c, clock, dt) && !admits_rate(c, clock, dt, rate);
        if (!open || (c->ahead->count > begun && c->ahead->fresh == 0)) break; /* K has been found anew */
        const int grown = work_ahead(c);
        if (grown < 0) hold_blind(c);
        open = grown > 0;
    }
    if (open) failed = !may_admit(c, clock, dt, rate);
    swap_grasps(c);
    return failed ? -1 : open && *steps > 0;
}

static void preview_reset(Core *c, double clock, int later) {
    preview_try(c, clock, 0);
    swap_grasps(c);
    if (c->ahead->count > 0 && !later)
        extend_horizon(c, clock, c->options->nominal_dt, INFINITY, NEWTON_STEPS_AT_START, INFINITY);
    for (int i = 0; i < SURVEYS_AT_START && !later && survey_ahead(c);) i++; /* what the first steps would do of it */
    swap_grasps(c);
}

static double cap_ahead(Core *c, double clock, double dt, double most) {
    Ahead *a = c->ahead;
    int cause = -1;
    name_cause(c->proposal->cause, NONE, -1, -1);
    if (!(isfinite(clock) && isfinite(dt))) return 0.0;
    if (a->count == 0 && first_node(c, clock)) push_node(c); /* the path failed where it began */
    if (a->count == 0) {
        hold_blind(c);
        return 0.0;
    }
    /* Beside bodies growth goes on before the rate is no longer known to be free. */
    const double early = c->bound_node ? steps_to_grow(c) * c->options->nominal_dt : 0.0;
    if (clock < a->free_until - early && dt <= c->options->nominal_dt) {
        if (clock >= a->grow_from) work_early(c);
        return 1.0;
    }
    extend_horizon(c, clock, dt, most, c->options->newton_steps, most_asked(c));
    if (!a->complete && !reaches(c, clock + steps_to_grow(c) * dt, dt) && !c->asked) work_early(c);
    a->ends_in_stop = false;
    const double cap = cap_on_horizon(c, clock, dt, most, &cause);
    if (cause >= 0) c->proposal->cause = node(c, cause)->cause;
    return cap > 0.0 ? cap : 0.0;
}

static double preview_cap(Core *c, double clock, double dt, double most) {
    if (!c->ahead->growing) take_grasps(c);
    swap_grasps(c);
    const double cap = cap_ahead(c, clock, dt, most);
    swap_grasps(c);
    return cap;
}

/* Largest rise of σ near a clock by further constraints, and by joints that no step limits; the joint, or −1. */
static double preview_rise(const Core *c, double clock, int *joint) {
    const int count = c->ahead->count;
    *joint = -1;
    if (!count) return INFINITY;
    const int i = node_before(c, clock), ahead = i + 1 < count ? i + 1 : i;
    const double rise = minimum(node(c, i)->rise, node(c, ahead)->rise);
    if (accelerates(c)) return rise;
    const double *slope = vector_of(c, c->node_slope, i), *next = vector_of(c, c->node_slope, ahead);
    double most = 0.0;
    int tightest = 0;
    for (int j = 0; j < c->joints; j++) {
        const double share = maximum(fabs(slope[j]), fabs(next[j])) / c->plan_acceleration[j];
        if (share > most) most = share, tightest = j;
    }
    if (!(most > 0.0 && 1.0 / most < rise)) return rise;
    *joint = tightest;
    return 1.0 / most;
}

/* D: from (η a + c σ²) / (|q′| + max(c, 0) σ dt) with c = q″ sign q′ of every joint that moves. */
static double preview_brake(const Core *c, double clock, double dt, double rate) {
    double *slope = c->scratch, *curvature = slope + c->joints, least = INFINITY;
    /* A corner takes the whole acceleration: the rate stays while it is passed. */
    if (next_breakpoint(c, clock - rate * dt) <= minimum(clock + rate * dt, c->duration - 1e-9)) return 0.0;
    joints_at(c, clock, slope, curvature);
    for (int j = 0; j < c->joints; j++) {
        const double speed = fabs(slope[j]), bend = slope[j] < 0.0 ? -curvature[j] : curvature[j];
        if (!(speed > 0.0)) continue;
        least = minimum(least, (c->plan_acceleration[j] + bend * rate * rate) / (speed + maximum(bend, 0.0) * rate * dt));
    }
    return least;
}

static void preview_reference(Core *c, double clock, double *positions, double *slope) {
    if (c->ahead->count == 0) {
        Vector(positions, c->joints, 1) = c->positions;
        Vector(slope, c->joints, 1).setZero();
        return;
    }
    leave_behind(c, clock);
    const int ahead = c->ahead->count > 1 ? 1 : 0;
    const double *x = vector_of(c, c->node_positions, 0), *first = vector_of(c, c->node_slope, 0);
    const double *second = vector_of(c, c->node_slope, ahead);
    const double span = node(c, ahead)->clock - node(c, 0)->clock;
    const double share = span > 0.0 ? clamp((clock - node(c, 0)->clock) / span, 0.0, 1.0) : 0.0;
    /* Quadratic from the grid point before: exact to second order, continuous to third. */
    for (int j = 0; j < c->joints; j++) {
        slope[j] = first[j] + share * (second[j] - first[j]);
        positions[j] = x[j] + 0.5 * (first[j] + slope[j]) * (share * span);
    }
}
