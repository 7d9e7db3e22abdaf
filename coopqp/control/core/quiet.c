/* Where further constraints are known to be quiet: Quiet in coopqp/control/constraints.py. */

#include "functions.h"

/* Σ reach |x − centre| */
static double way_from(const Core *c, const double *x, const double *centre, const double *reach) {
    double way = 0.0;
    for (int j = 0; j < c->joints; j++) way += reach[j] * fabs(x[j] - centre[j]);
    return way;
}

/* No further row binds the command, without asking for them. */
static int quiet_step(const Core *c) {
    const double h = c->proposal[DT], share = minimum(c->loop[QUIET_APPROACH] * h, 1.0);
    double run = 0.0;
    for (int j = 0; j < c->joints; j++) run += c->quiet_reach[j] * fabs(c->command[j]);
    return h * run < share * (c->loop[QUIET_SLACK] - way_from(c, c->positions, c->quiet_centre, c->quiet_reach));
}

/* No further constraint asks for anything ahead at x. */
static int quiet_ahead(const Core *c, const double *x) {
    return way_from(c, x, c->quiet_ahead_centre, c->quiet_ahead_reach) < c->loop[QUIET_AHEAD];
}

/* No further constraint stops the object between the knot before and one at x, `span` after it. */
static int quiet_knot(Core *c, const double *x, const double *slope, const double *curvature, double span) {
    double *before = c->scratch;
    for (int j = 0; j < c->joints; j++) before[j] = x[j] - (slope[j] - 0.5 * span * curvature[j]) * span;
    return quiet_ahead(c, x) && quiet_ahead(c, before);
}
