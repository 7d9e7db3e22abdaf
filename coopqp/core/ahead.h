/* The memory of the look-ahead, and the functions that its files share.
 *
 * Grid points lie in a ring, numbered from the one at or before the clock; `place` is where in the ring. `count` of them are
 * known. Behind these lie tentative ones: `way` grid points of a way past a singularity, then the grid point that is being tried. So
 * all that a pause has to keep is in the state, and a copy of the state goes on as the original would. */

#ifndef COOPQP_AHEAD_H
#define COOPQP_AHEAD_H

#include "functions.h"

/* Outcome of one Newton step at the tried grid point. CANNOT_SAY: a user's path, or a further constraint, fails. */
enum Trial { PENDING, REJECTED, FOUND, CANNOT_SAY };

static int place_of(const Core *c, int i) { return (c->ahead->head + i) % MOST_NODES; }

static Node *node_in(const Core *c, int place) { return c->nodes + place; }

static Node *node(const Core *c, int i) { return node_in(c, place_of(c, i)); }

/* Vectors of grid point i: node_positions, node_slope, node_curvature or node_bending. */
static double *vector_of(const Core *c, double *vectors, int i) {
    return vectors + (size_t)place_of(c, i) * (size_t)c->joints;
}

/* Joint motion from grid point i to where each arm's reach ends. */
static double *edges_of(const Core *c, int i) { return vector_of(c, c->node_edges, i); }

static void copy_node(Core *c, int from, int to) {
    const size_t bytes = sizeof(double) * (size_t)c->joints;
    if (from == to) return;
    *node(c, to) = *node(c, from);
    for (double *vectors : {c->node_positions, c->node_slope, c->node_curvature, c->node_bending, c->node_edges})
        memcpy(vector_of(c, vectors, to), vector_of(c, vectors, from), bytes);
}

static void name_cause(Cause &cause, LimitKind kind, int arm, int joint) {
    cause = Cause{kind, arm, joint};
}

/* The arm of a joint; of a shared one the first that has it. */
static int arm_of(const Core *c, int joint) {
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < joints_behind(c, k); i++)
            if (joint_behind(c, k, i) == joint) return k;
    return 0;
}

/* -- sharing.cpp ---------------------------------------------------------------------------------------- */

/* Largest z ≤ cap that some |u| ≤ slope_cap allows at grid point i alone. */
static double largest_alone(const Core *c, int i);
/* Largest z at grid point i from which z at the next grid point can be in [0, K there], and its slope over K there; the joint
 * whose acceleration makes it, or helps to, or −1. */
static int find_share(Core *c, int i);

/* -- horizon.cpp ---------------------------------------------------------------------------------------- */

/* The first tentative grid point becomes the last known one. */
static void push_node(Core *c);
/* Nothing comes after the last grid point. */
static void finish_horizon(Core *c);
/* Drop grid points that another follows before `clock`. */
static void leave_behind(Core *c, double clock);
/* Number of the last grid point at or before `clock`. */
static int node_before(const Core *c, double clock);
/* Whether K is final along a step from `clock`: the end of the horizon does not make it. */
static int reaches(const Core *c, double clock, double dt);
/* q′ and q″ at a clock, from the grid points around it. */
static void joints_at(const Core *c, double clock, double *slope, double *curvature);
/* Clock until which the known horizon lets the object go on at full rate, less a margin. */
static double free_until(const Core *c, double margin);

/* The least K of a step, its slope over the step's rate, and the grid point that makes it. */
struct Least {
    double square, slope;
    int cause;
};

static Least least_square(const Core *c, double clock, double rate, double dt);
/* The largest rate below 1 that K admits for a step. `least` is the least K at rate 1, on return at the rate found. */
static double largest_rate(const Core *c, double clock, double dt, Least *least);

/* Whether K admits a rate for a step already. */
static int admits_rate(const Core *c, double clock, double dt, double rate);
/* Whether K may come to admit a rate for a step as more grid points become known. */
static int may_admit(Core *c, double clock, double dt, double rate);

/* -- chain_ahead.cpp ------------------------------------------------------------------------------------ */

/* The grid point at a clock, at the commanded positions, as the first tentative one; 0 if the path fails. */
static int first_node(Core *c, double clock);
/* One Newton step at grid point `made`, `span` after grid point `last`; rejected if the arms or their slopes do not follow. */
static Trial try_node(Core *c, int last, int made, double span, int iteration);
/* Where the twist jumps at grid point i: slopes after it, and the rate at which the joints can take the jump; 0 if the path
 * fails. */
static int turn_corner(Core *c, int i);
/* Where the joints are expected a span after grid point `last`: as q′ and q″ go on, or with the elbows that lead them. */
static void expect(const Core *c, int last, double span, double *x);
/* The last known grid point once more, as the first tentative one, where the path ends moving; 0 if that needs nothing. */
static int end_moving(Core *c);

/* The arm that is at the end of its reach at grid point i, or −1. */
static int stretched_arm(const Core *c, int i);

/* -- redundancy.cpp ------------------------------------------------------------------------------------- */

/* Lead the joints of redundant arm k away from their limits by its self-motion. */
static void lead_away(Core *c, int k, const double *jacobian, const double *positions, double *slope);

/* -- growth.cpp ----------------------------------------------------------------------------------------- */

/* One Newton step, so that no single control step has to make a whole grid point; 0 where growth has to wait, −1 where the
 * look-ahead fails. */
static int work_ahead(Core *c);
/* A piece of work on bodies where the next grid point is expected; 0 if there is nothing to do. */
static int survey_ahead(Core *c);

#endif
