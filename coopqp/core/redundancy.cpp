/* Self-motion that keeps the joints of redundant arms off their limits on a path.
 *
 * Near a limit at distance d the slope of a joint towards it is at most S (d − m) / w, with the margin m, the way w, and the
 * arm's largest slope S in units of the joints' speeds. The least self-motion that keeps these bounds is taken. If none does,
 * all bounds give way by the same, in units of the joints' speeds. An arm with more than one joint beyond six uses the
 * self-motion that moves the joint that is worst off. Arms that share joints are one arm here.
 *
 * On the way the slope n of that joint along the self-motion changes by its bend κ. Away from the limit at the distance D it
 * bends by itself where κ > 0, as with the elbow in the arm's plane, where n is 0: it wins back D where its slope has become
 * √(2 κ D), which is counted with where n is smaller. Where κ < 0 it can win G = n² / 2|κ| and no more: n (1 + D / G) is
 * counted with, so an elbow is not turned ever faster for nothing. */

#include "ahead.h"

constexpr double LIMIT_MARGIN = 0.003; /* self-motion keeps joints inside their limits by this distance [rad or m] */
constexpr double TURNING_WAY = 0.02; /* within this way before they turn away [rad or m] */
/* A joint that its arm's self-motion moves by a smaller share cannot be led away, unless it bends away */
constexpr double LEADS = 1e-4;
/* With a smaller share an elbow is in its arm's plane: either way round bends the joint alike */
constexpr double IN_PLANE = 1e-8;
constexpr double TURNS_WELL = 0.1; /* a joint turns well by a self-motion of unit speed where its slope is larger [1] */

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
    const ArmJoints &a = joints_of(c, k);
    const Vector6 none = Vector6::Zero();
    double push[MOST_JOINTS] = {0}, other[MOST_JOINTS], columns[6 * MOST_JOINTS], units[MOST_JOINTS];
    const double *J = side_by_side(a, jacobian, 6, columns), *scale = side_by_side(a, c->scale, 1, units);
    push[j] = 1.0;
    return arm_velocities(J, scale, a.n, none, none, push, no_reference, way, other) > 0.0 ||
           far_velocities(J, scale, a.n, none, none, push, no_reference, way, other) > 0.0;
}

/* How joint `j` of these bends along a self-motion (n,) of arm k, or of its group: −A⁺ J′(w) w; 0 if it is singular. */
static double bend_of_joint(Core *c, int k, const double *jacobian, const double *way, int j) {
    const int nv = c->joints, n = joints_together(c, k);
    Vector moving(c->scratch, nv, 1), moved(moving + nv, nv, 1), other(moving + 2 * nv, nv, 1);
    moving.setZero();
    for (int i = 0; i < n; i++) moving[joint_together(c, k, i)] = way[i];
    if (const Group *g = group_of(c, k)) {
        Twists bends(moving + 3 * nv, 6, c->arms);
        for (int i = 0; i < g->arms; i++) bends.col(g->arm[i]) = -bend(c, g->arm[i], jacobian, moving);
        return group_velocities(c, *g, jacobian, bends, nullptr, false, nullptr, nullptr, moved, other) ? moved[g->joint[j]] : 0.0;
    }
    double columns[6 * MOST_JOINTS], units[MOST_JOINTS];
    const ArmJoints &a = joints_of(c, k);
    const double *J = side_by_side(a, jacobian, 6, columns), *scale = side_by_side(a, c->scale, 1, units);
    const Vector6 bends = -bend(c, k, jacobian, moving), none = Vector6::Zero();
    const bool found = arm_velocities(J, scale, n, bends, none, no_reference, no_reference, moved, other) > 0.0 ||
                       far_velocities(J, scale, n, bends, none, no_reference, no_reference, moved, other) > 0.0;
    return found ? moved[j] : 0.0;
}

/* The self-motion of arm k, or of its group, that moves joint `j` of these, at unit speed; returns that joint's share. */
static double unit_motion(Core *c, int k, const double *jacobian, int j, double *way) {
    const double share = self_motion(c, k, jacobian, j, way) ? way[j] : 0.0;
    const double unit = share > IN_PLANE ? c->scale[joint_together(c, k, j)] / sqrt(share) : 0.0;
    for (int i = 0; i < joints_together(c, k); i++) way[i] *= unit;
    return share;
}

/* The self-motion, at unit speed, that leads joint `worst` of these to its side, away from its limit, `left` away. Returns the
 * joint's slope along it that is counted with; 0 if it cannot be led. */
static double lever_of(Core *c, int k, const double *jacobian, int worst, double side, double left, double *way) {
    const int n = joints_together(c, k);
    const auto scale = [&](int i) { return c->scale[joint_together(c, k, i)]; };
    const double share = unit_motion(c, k, jacobian, worst, way);
    double bends = 0.0;
    if (share > IN_PLANE) {
        bends = side * bend_of_joint(c, k, jacobian, way, worst);
    } else { /* of all self-motions that which bends it most; its first joint that turns well goes upwards */
        int first = 0;
        for (int j = 0; j < n; j++) {
            double motion[MOST_GROUP_JOINTS];
            if (!(unit_motion(c, k, jacobian, j, motion) > LEADS)) continue;
            const double own = side * bend_of_joint(c, k, jacobian, motion, worst);
            if (own > bends) bends = own, std::copy(motion, motion + n, way);
        }
        while (first < n - 1 && !(fabs(way[first]) > TURNS_WELL * scale(first))) first++;
        for (int i = 0, turned = way[first] < 0.0; turned && i < n; i++) way[i] = -way[i];
    }
    const double own = scale(worst) * sqrt(maximum(share, 0.0)), won = 2.0 * bends * maximum(left, 0.0);
    if (won > 0.0) return maximum(own, sqrt(won)) > LEADS * scale(worst) ? maximum(own, sqrt(won)) : 0.0;
    const double lever = own > 0.0 ? own - won / own : 0.0;
    return lever > sqrt(LEADS) * scale(worst) ? lever : 0.0;
}

/* Lead the joints of redundant arm k, or of its group, away from their limits by its self-motion. */
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
    int worst = 0;
    double lever = 0.0;
    for (int tries = 0; tries < n && !(lever > 0.0); tries++) {
        worst = 0;
        for (int j = 1; j < n; j++)
            if (beyond[j] > beyond[worst]) worst = j;
        if (!(beyond[worst] > 0.0)) return;
        const double x = positions[at(worst)], side = slope[at(worst)] > up[worst] ? -1.0 : 1.0;
        const double left = side > 0.0 ? x - c->low[at(worst)] : c->high[at(worst)] - x;
        lever = lever_of(c, k, jacobian, worst, side, left, way);
        beyond[worst] = -INFINITY;
    }
    if (!(lever > 0.0)) return;
    double low = -INFINITY, high = INFINITY, z, missing = 0.0;
    double lows[MOST_GROUP_JOINTS], highs[MOST_GROUP_JOINTS], gives[MOST_GROUP_JOINTS];
    int moved = 0;
    for (int j = 0; j < n; j++) {
        if (j != worst && !(fabs(way[j]) > LEADS * lever)) continue;
        const double along = j == worst ? lever : way[j];
        const double own = slope[at(j)], a = (down[j] - own) / along, b = (up[j] - own) / along;
        lows[moved] = minimum(a, b), highs[moved] = maximum(a, b);
        gives[moved++] = c->scale[at(j)] / fabs(along);
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
