/* Arms that do not hold the object and follow a way of their joints: coopqp/paths/joint_path.py defines it.
 *
 * The numbers follow those of the tools' motion, see grasps.cpp: how many ways there are; then each way: its arm, the
 * clocks at its ends, origin and sense of its own clock ``origin + sense · clock − begins``, begins, how many rows (m), and
 * whether joints go straight from row to row, by the quintic time law; the clocks of its rows (m), positions and speeds
 * there (2 m n). Where the tool is does not count: such an arm carries the object where the others do. */

#include "functions.h"

static const double *ways_of(const Core *c) { return pieces_of_arm(c, c->arms); }

static int way_size(int joints, double rows) { return WAY_HEAD + (1 + 2 * joints) * (int)rows; }

/* The way that an arm follows at a clock; nullptr where it goes with the object. */
static const double *way_at(const Core *c, int k, double clock) {
    const double *way = ways_of(c);
    for (int left = (int)*way++; left > 0; left--) {
        if (way[0] == k && way[1] <= clock && clock < way[2]) return way;
        way += way_size(joints_of(c, (int)way[0]).n, way[6]);
    }
    return nullptr;
}

/* Positions and speeds of the arm's joints on a way at a clock; those of an end beyond it. */
static void on_way(const Core *c, const double *way, double clock, double *x, double *speed) {
    const int n = joints_of(c, (int)way[0]).n, rows = (int)way[6], last = rows - 1;
    const double *clocks = way + WAY_HEAD, *at = clocks + rows, *slopes = at + n * rows;
    const double sense = way[4], t = way[3] + sense * clock - way[5];
    if (!(t >= 0.0 && t < clocks[last])) {
        const double *end = at + (t < 0.0 ? 0 : n * last);
        for (int j = 0; j < n; j++) x[j] = end[j], speed[j] = 0.0;
        return;
    }
    int i = 0;
    while (i + 2 < rows && clocks[i + 1] <= t) i++;
    const double h = clocks[i + 1] - clocks[i], u = (t - clocks[i]) / h;
    const double *before = at + n * i, *after = before + n, *v = slopes + n * i, *w = v + n;
    const Place share = on_law(u, 1.0, 0.0, h);
    for (int j = 0; j < n; j++) {
        const double distance = after[j] - before[j];
        if (way[7] != 0.0) {
            x[j] = before[j] + share.u * distance, speed[j] = sense * share.rate * distance;
            continue;
        }
        const double bend = 3.0 * distance - h * (2.0 * v[j] + w[j]), twist = h * (v[j] + w[j]) - 2.0 * distance;
        x[j] = before[j] + u * (h * v[j] + u * (bend + u * twist));
        speed[j] = sense * (v[j] + u * (2.0 * bend + 3.0 * u * twist) / h);
    }
}

/* From now on these arms follow a way of their joints: those that do at a clock. */
static void take_ways(Core *c, double clock) {
    for (int k = 0; k < c->arms; k++) c->own_way[k] = way_at(c, k, clock) != nullptr;
}

static bool follows_way(const Core *c, int k) { return c->grasp_numbers && c->own_way[k] != 0.0; }

static bool any_follows_way(const Core *c) { return c->grasp_numbers && (c->own_way.array() != 0.0).any(); }

/* The first arm that follows no way of its own: some arm holds the object. */
static int first_with_object(const Core *c) {
    int arm = 0;
    while (any_follows_way(c) && arm + 1 < c->arms && c->own_way[arm] != 0.0) arm++;
    return arm;
}

/* Arms that follow a way of their joints carry the object where the first of the others does. */
static void carry_with_others(const Core *c, Pose *carried) {
    if (!any_follows_way(c)) return;
    const Pose &held = carried[first_with_object(c)];
    for (int k = 0; k < c->arms; k++)
        if (c->own_way[k] != 0.0) carried[k] = held;
}

/* Newton's step and q′ of these arms, a moment `before` a clock: onto the way, and along it. */
static void along_ways(const Core *c, double clock, double before, const double *positions, double *step, double *slope) {
    const double side = maximum(minimum(clock, c->duration) - before, 0.0);
    double speed[MOST_JOINTS], x[MOST_JOINTS], unused[MOST_JOINTS];
    for (int k = 0; k < c->arms; k++) {
        if (!follows_way(c, k)) continue;
        const ArmJoints &a = joints_of(c, k);
        const double *way = way_at(c, k, side);
        on_way(c, way, clock - before, unused, speed);
        for (int i = 0; i < a.n; i++) slope[a.own(i)] = speed[i];
        on_way(c, way, clock, x, speed);
        for (int i = 0; i < a.n; i++) step[a.own(i)] = x[i] - positions[a.own(i)];
    }
}

/* What the joints of these arms are to do in a step, per unit of rate and beside it: along the way, and back onto it. */
static void reference_along_ways(Core *c, double clock, double span, double h) {
    const double gain = c->proposal->hold ? 0.0 : min_of(c->options->grasp_gain, 1.0 / h);
    double now[MOST_JOINTS], later[MOST_JOINTS], speed[MOST_JOINTS], unused[MOST_JOINTS];
    for (int k = 0; k < c->arms; k++) {
        if (!follows_way(c, k)) continue;
        const ArmJoints &a = joints_of(c, k);
        const double *way = way_at(c, k, clock);
        on_way(c, way, clock, now, speed);
        on_way(c, way, min_of(clock + span, way[2]), later, unused);
        for (int i = 0; i < a.n; i++) {
            c->null_along[a.own(i)] = span > 1e-12 ? (later[i] - now[i]) / span : speed[i];
            c->null_offset[a.own(i)] = gain * (now[i] - c->positions[a.own(i)]);
        }
    }
}

/* Hold where an arm is far from its way: it would rush there. */
static void watch_ways(Core *c, double clock) {
    double x[MOST_JOINTS], speed[MOST_JOINTS];
    for (int k = 0; k < c->arms; k++) {
        if (!follows_way(c, k)) continue;
        const ArmJoints &a = joints_of(c, k);
        int joint = 0;
        double most = 0.0;
        on_way(c, way_at(c, k, clock), clock, x, speed);
        for (int i = 0; i < a.n; i++) {
            const double far = fabs(c->positions[a.own(i)] - x[i]);
            if (far > most) most = far, joint = a.own(i);
        }
        if (most > FAR_FROM_WAY && !c->proposal->hold) {
            refuse(c, OFF_WAY, -1, most);
            c->proposal->reason_b = joint;
        }
    }
}
