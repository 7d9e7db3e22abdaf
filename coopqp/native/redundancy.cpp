/* Self-motion of redundant arms where a joint nears its position limit: coopqp/control/lookahead/redundancy.py. */

#include "ahead.h"

/* Self-motion of arm k, or of its group, that moves joint `j` of these, (n,); 0 if it is singular. */
static int self_motion(Core *c, int k, const double *jacobian, int j, double *way) {
    if (const Group *g = group_of(c, k)) {
        const int nv = c->joints;
        Vector push(c->scratch, nv, 1), moved(push + nv, nv, 1), other(push + 2 * nv, nv, 1);
        push.setZero(), push[g->joint[j]] = 1.0;
        if (!group_velocities(c, *g, jacobian, nullptr, nullptr, false, push, nullptr, moved, other)) return 0;
        for (int i = 0; i < g->joints; i++) way[i] = moved[g->joint[i]];
        return 1;
    }
    static const double still[MOST_JOINTS] = {};
    const auto [start, n] = joints_of(c, k);
    const Vector6 none = Vector6::Zero();
    double push[MOST_JOINTS] = {0}, other[MOST_JOINTS];
    const double *J = jacobian + 6 * start, *scale = c->scale + start;
    push[j] = 1.0;
    return arm_velocities(J, scale, n, none, none, push, still, way, other) > 0.0 ||
           far_velocities(J, scale, n, none, none, push, still, way, other) > 0.0;
}

/* Lead the joints of redundant arm k, or of its group, away from their limits by its self-motion:
 * coopqp/control/lookahead/redundancy.py. */
static void lead_away(Core *c, int k, const double *jacobian, const double *positions, double *slope) {
    const int n = joints_together(c, k);
    double up[MOST_GROUP_JOINTS], down[MOST_GROUP_JOINTS], beyond[MOST_GROUP_JOINTS], way[MOST_GROUP_JOINTS], largest = 0.0;
    const auto at = [&](int i) { return joint_together(c, k, i); };
    for (int j = 0; j < n; j++) largest = maximum(largest, fabs(slope[at(j)]) / c->scale[at(j)]);
    largest /= TURNING_WAY;
    if (!(largest > 0.0)) return;
    for (int j = 0; j < n; j++) {
        const double x = positions[at(j)], scale = c->scale[at(j)], own = slope[at(j)];
        up[j] = largest * scale * (c->high[at(j)] - LIMIT_MARGIN - x);
        down[j] = largest * scale * (c->low[at(j)] + LIMIT_MARGIN - x);
        beyond[j] = maximum(own - up[j], down[j] - own) / scale;
    }
    int worst = 0, found = 0;
    for (int tries = 0; tries < n && !found; tries++) {
        worst = 0;
        for (int j = 1; j < n; j++)
            if (beyond[j] > beyond[worst]) worst = j;
        if (!(beyond[worst] > 0.0)) return;
        found = self_motion(c, k, jacobian, worst, way) && way[worst] > LEADS;
        beyond[worst] = -INFINITY;
    }
    if (!found) return;
    double low = -INFINITY, high = INFINITY, z, missing = 0.0;
    double lows[MOST_GROUP_JOINTS], highs[MOST_GROUP_JOINTS], gives[MOST_GROUP_JOINTS];
    int moved = 0;
    for (int j = 0; j < n; j++) {
        if (!(fabs(way[j]) > LEADS * way[worst])) continue;
        const double own = slope[at(j)], a = (down[j] - own) / way[j], b = (up[j] - own) / way[j];
        lows[moved] = minimum(a, b), highs[moved] = maximum(a, b);
        gives[moved++] = c->scale[at(j)] / fabs(way[j]);
        low = maximum(low, minimum(a, b)), high = minimum(high, maximum(a, b));
    }
    z = minimum(maximum(0.0, low), high);
    for (int i = 0; low > high && i < moved; i++)
        for (int j = 0; j < moved; j++) { /* of bounds that contradict each other, each gives way as much, in units of speed */
            const double give = (lows[i] - highs[j]) / (gives[i] + gives[j]);
            if (give > missing) missing = give, z = lows[i] - give * gives[i];
        }
    for (int j = 0; j < n; j++) slope[at(j)] += z * way[j];
}
