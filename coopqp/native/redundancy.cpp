/* Self-motion of redundant arms where a joint nears its position limit: coopqp/control/lookahead/redundancy.py. */

#include "ahead.h"

/* Self-motion of arm k that moves its joint `j`, (n,); 0 if the arm is singular. */
static int self_motion(const Core *c, int k, const double *jacobian, int j, double *way) {
    static const double still[MOST_JOINTS] = {};
    const auto [start, n] = joints_of(c, k);
    const Vector6 none = Vector6::Zero();
    double push[MOST_JOINTS] = {0}, other[MOST_JOINTS];
    const double *J = jacobian + 6 * start, *scale = c->scale + start;
    push[j] = 1.0;
    return arm_velocities(J, scale, n, none, none, push, still, way, other) > 0.0 ||
           far_velocities(J, scale, n, none, none, push, still, way, other) > 0.0;
}

/* Lead the joints of redundant arm k away from their limits by its self-motion: coopqp/control/lookahead/redundancy.py. */
static void lead_away(const Core *c, int k, const double *jacobian, const double *positions, double *slope) {
    const int start = (int)c->arm_start[k], n = (int)c->arm_size[k];
    double up[MOST_JOINTS], down[MOST_JOINTS], beyond[MOST_JOINTS], way[MOST_JOINTS], largest = 0.0;
    for (int j = 0; j < n; j++) largest = maximum(largest, fabs(slope[start + j]) / c->scale[start + j]);
    largest /= TURNING_WAY;
    if (!(largest > 0.0)) return;
    for (int j = 0; j < n; j++) {
        const double x = positions[start + j], scale = c->scale[start + j], own = slope[start + j];
        up[j] = largest * scale * (c->high[start + j] - LIMIT_MARGIN - x);
        down[j] = largest * scale * (c->low[start + j] + LIMIT_MARGIN - x);
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
    double low = -INFINITY, high = INFINITY;
    for (int j = 0; j < n; j++) {
        if (!(fabs(way[j]) > LEADS * way[worst])) continue;
        const double own = slope[start + j], a = (down[j] - own) / way[j], b = (up[j] - own) / way[j];
        low = maximum(low, minimum(a, b)), high = minimum(high, maximum(a, b));
    }
    const double z = low > high ? 0.5 * (low + high) : minimum(maximum(0.0, low), high);
    for (int j = 0; j < n; j++) slope[start + j] += z * way[j];
}
