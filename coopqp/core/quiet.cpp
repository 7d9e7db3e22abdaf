/* Where further constraints are known to be quiet: Quiet in coopqp/constraints/velocity.py. */

#include "functions.h"

/* Σ reach (|x − centre| + h |v|) over the joints of the two arms where it is largest, and over all shared joints; without v for
 * nullptr. */
static double way_from(const Core *c, const double *x, const double *centre, const double *reach, const double *v, double h) {
    double first = 0.0, second = 0.0, shared = 0.0;
    const auto way_of = [&](int j) { return reach[j] * (fabs(x[j] - centre[j]) + (v ? h * fabs(v[j]) : 0.0)); };
    for (int k = 0; k < c->arms; k++) {
        const ArmJoints &a = joints_of(c, k);
        double way = 0.0;
        for (int i = 0; i < a.n; i++) way += way_of(a.own(i));
        if (way > first)
            second = first, first = way;
        else
            second = maximum(second, way);
    }
    for (int i = 0; i < c->groups; i++)
        for (int j = 0; j < c->group[i].shared; j++) shared += way_of(c->group[i].joint[j]);
    return first + second + shared;
}

/* No further row binds the command, without asking for them. */
static int quiet_step(const Core *c) {
    const double h = c->proposal->dt, share = minimum(c->loop->quiet_approach * h, 1.0);
    if (!(share > 0.0)) return 0;
    return way_from(c, c->positions, c->quiet_centre, c->quiet_reach, c->command, h / share) < c->loop->quiet_slack;
}

/* No further constraint asks for anything ahead at x. */
static int quiet_ahead(const Core *c, const double *x) {
    return way_from(c, x, c->quiet_ahead_centre, c->quiet_ahead_reach, nullptr, 0.0) < c->loop->quiet_ahead_slack;
}

/* No further constraint stops the object between the grid point before and one at x, `span` after it. */
static int quiet_node(Core *c, const double *x, const double *slope, const double *curvature, double span) {
    double *before = c->scratch;
    for (int j = 0; j < c->joints; j++) before[j] = x[j] - (slope[j] - 0.5 * span * curvature[j]) * span;
    return quiet_ahead(c, x) && quiet_ahead(c, before);
}
