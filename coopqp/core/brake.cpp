/* All arms brake together, as hard as the box allows, without a solver: along the path if a rate is admissible, else along the
 * object's present motion, else by one common factor. What redundant arms do in their null-space fades with the rest. */

#include "functions.h"

constexpr int BISECTIONS = 40; /* of a share that breaks rows least */

/* Joint velocities for one world twist of each arm, of the floored inverses. */
static void floored_velocities(const Core *c, const double *jacobian, const Twists &w, Vector &v) {
    ArmRows6 P;
    ArmSquare N;
    GroupRows all;
    GroupSquare none;
    v.setZero();
    for (int k = 0; k < c->arms; k++) {
        if (follows_way(c, k) || !leads_group(c, k)) continue;
        if (const Group *g = group_of(c, k)) {
            GroupTwists twists(6 * g->arms);
            for (int i = 0; i < g->arms; i++) twists.segment<6>(6 * i) = w.col(g->arm[i]);
            any_inverse(stacked(c, *g, jacobian), gathered(*g, c->scale), all, none);
            const GroupVector found = all.lazyProduct(twists);
            for (int j = 0; j < g->joints; j++) v[g->joint[j]] = found[j];
            continue;
        }
        const ArmJoints &a = joints_of(c, k);
        double columns[6 * MOST_JOINTS], room[2][MOST_JOINTS], *own = place_for(a, v, room[0]);
        const OfArm J(side_by_side(a, jacobian, 6, columns), 6, a.n);
        any_inverse(ArmColumns(J), Given(side_by_side(a, c->scale, 1, room[1]), a.n), P, N);
        OfJoints(own, a.n) = P.lazyProduct(w.col(k));
        spread(a, own, v);
    }
}

/* World twists of the object as velocities make them. */
static void twists_of(const Core *c, const Vector &v, Twists &w) {
    for (int k = 0; k < c->arms; k++) {
        const ArmColumns J = columns_of_arm(c, k, c->jacobian);
        w.col(k).setZero();
        for (int j = 0; j < J.cols() && !follows_way(c, k); j++) w.col(k) += v[joint_behind(c, k, j)] * J.col(j);
    }
}

/* Take from velocities what moves the object. */
static void leave_self_motion(const Core *c, Twists &w, Vector &moving, Vector &v) {
    twists_of(c, v, w);
    floored_velocities(c, c->jacobian, w, moving);
    for (int k = 0; k < c->arms; k++) {
        if (!leads_group(c, k) || follows_way(c, k)) continue;
        const bool redundant = joints_together(c, k) > 6 * (group_of(c, k) ? group_of(c, k)->arms : 1);
        for (int i = 0; i < joints_together(c, k); i++) {
            const int j = joint_together(c, k, i);
            v[j] = redundant ? v[j] - moving[j] : 0.0;
        }
    }
}

/* By how much base + share · along breaks the soft rows, or all of them, at most; and by how much more with a larger share. */
static double broken(const Core *c, bool all, const double *base, const double *along, double share, double *more) {
    double most = -INFINITY;
    *more = 0.0;
    for (int r = 0; r < c->further_rows; r++) {
        if (!all && c->further_soft[r] == 0.0) continue;
        const double slope = further(c, r, along), value = further(c, r, base) + share * slope;
        if (value - c->further_upper[r] > most) most = value - c->further_upper[r], *more = slope;
        if (c->further_lower[r] - value > most) most = c->further_lower[r] - value, *more = -slope;
    }
    return most;
}

/* The share in [low, max(low, min(high, 1))] that breaks rows least, the smallest of equals, and by how much. */
static double least_broken(const Core *c, bool all, const double *base, const double *along, double low, double high,
                           double *by) {
    double more;
    *by = 0.0;
    if (broken(c, all, base, along, low, &more) <= LIMIT_TOLERANCE) return low;
    high = max_of(low, min_of(high, 1.0));
    for (int i = 0; i < BISECTIONS; i++) { /* the largest excess is a convex function of the share */
        const double middle = 0.5 * (low + high), excess = broken(c, all, base, along, middle, &more);
        if (more < 0.0 && excess > 0.0) low = middle;
        else high = middle;
    }
    const double excess = broken(c, all, base, along, high, &more);
    if (excess > LIMIT_TOLERANCE) *by = excess;
    return high;
}

/* The largest common braking: the factor that the tightest joint can follow in one step. */
static double slowdown(const Core *c, double h) {
    double reach = INFINITY;
    for (int j = 0; j < c->joints; j++) {
        const double speed = fabs(c->velocity[j]);
        if (speed > 1e-12) reach = min_of(reach, c->acceleration[j] * h / speed);
    }
    return reach == INFINITY ? 0.0 : 1.0 - min_of(reach, 1.0);
}

/* The first of these that keeps the hard rows is taken, else the one that breaks the soft rows by the least. */
static void brake_now(Core *c) {
    Proposal *p = c->proposal;
    const int nv = c->joints;
    const double length = c->unit[0] / c->unit[3];
    const auto vector = [&](int i) { return Vector(c->scratch + 12 * c->arms + i * nv, nv, 1); };
    Twists w(c->scratch, 6, c->arms), along(c->scratch + 6 * c->arms, 6, c->arms);
    Vector offsets = vector(0), grasp = vector(1), self = vector(2), path = vector(3), object = vector(4), work = vector(5);
    Vector6 metric = Vector6::Ones(), mean = Vector6::Zero(), twist = Vector6::Zero();
    metric.tail<3>().setConstant(length * length);
    for (int k = 0; k < c->arms; k++) w.col(k) = turned(c->pose->R, c->offsets.col(k));
    floored_velocities(c, c->jacobian, w, offsets);
    for (int k = 0; k < c->arms; k++) w.col(k) = turned(c->pose->R, c->grasp.col(k));
    floored_velocities(c, c->jacobian, w, grasp);
    grasp += offsets;
    self = c->velocity;
    twists_of(c, self, w);
    for (int k = 0; k < c->arms; k++) twist += w.col(k) / c->arms;
    leave_self_motion(c, w, work, self);
    for (int k = 0; k < c->arms; k++) {
        const Vector6 own = grasps_move(c) ? Vector6(c->own_along.col(k)) : Vector6(c->along);
        along.col(k) = own, mean += own / c->arms, w.col(k) = twist;
    }
    floored_velocities(c, c->jacobian, w, object);
    object += self;
    const Vector6 present = turned_back(c->pose->R, twist);
    const double size = mean.dot(metric.cwiseProduct(mean));
    const double rate = size > 0.0 ? max_of(mean.dot(metric.cwiseProduct(present)) / size, 0.0) : 0.0;
    for (int k = 0; k < c->arms; k++) w.col(k) = rate * turned(c->pose->R, along.col(k));
    floored_velocities(c, c->jacobian, w, path);
    path += self;
    double least = INFINITY;
    p->grasp_share = p->path_share = 0.0, p->parting = 0.0, p->braked = true, p->corrections_made = false;
    p->bindings = 0, p->binding_row = -1, p->new_rate = 0.0;
    c->off_path.setZero();
    for (int hard = 1; hard >= 0 && least == INFINITY; hard--)
        for (const Vector *motion : {&path, &object})
            for (const Vector *base : {&grasp, &offsets}) {
                Rates rates;
                double by;
                if (!admissible_rates(c, *base, *motion, hard ? ONLY_HARD_ROWS : NO_ROWS, &rates)) continue;
                if (!(rates.high >= max_of(rates.low, 0.0))) continue;
                const double share = least_broken(c, false, *base, *motion, max_of(rates.low, 0.0), rates.high, &by);
                if (!(by < least)) continue;
                least = by, c->command = *base + share * *motion, p->new_rate = min_of(share * rate, 1.0);
            }
    if (least == INFINITY) {
        double by;
        work.setZero();
        c->command = c->velocity * least_broken(c, true, work, c->velocity, slowdown(c, p->dt), 1.0, &by);
    }
    for (int j = 0; j < nv; j++) {
        const double most = fabs(c->speed[j]), v = isfinite(c->command[j]) ? c->command[j] : 0.0;
        c->command[j] = clamp(clamp(v, c->lower[j], c->upper[j]), -most, most);
    }
}
