/* Rows that brake all arms together ahead of singularities and joint limits, where no look-ahead does.
 *
 * An edge e(q) ≥ 0 is what must not be crossed: the least singular value of an arm's tool Jacobian, less a margin, and
 * the way of a joint to each of its limits. From the joint velocities v of the last step all joints come to rest
 * together in the time T = max_j |v_j| / a_j. The edge comes closer at s = max(−∇e·v, 0), so braking together slows it
 * down by a_e = S s / T. The next velocities v⁺ keep, with a step of length h,
 *
 *     −∇e·v⁺ ≤ max(min(e / max(0.05 s, 5 h), √(a_e² h² + 2 a_e e) − a_e h), (1 − h/T) s).
 *
 * The chain bends: an object that goes on with its twist makes joints accelerate by A⁻¹ Ȧ v. Where that takes too large
 * a share k of the accelerations, all joints slow down, for it falls with the square of their speed:
 *
 *     vᵀ W v⁺ ≤ max(√(η / k), 1 − h/T) vᵀ W v.
 *
 * Joints that brake together keep all rows, and so do joints at rest. See docs/derivations.md. */

#include "functions.h"

constexpr double EDGE_SHARE = 0.8; /* share of the accelerations that braking together is planned with, ahead of an edge */
constexpr double SINGULAR_MARGIN = 0.01; /* least singular value of a tool Jacobian that arms keep */
constexpr double BEND_SHARE = 0.7; /* share of the accelerations that the chain's bend may take, */
constexpr double BEND_OFF_PATH = 0.4; /* and off the path, where bodies push */
constexpr double GIVES_WAY = 0.1; /* how far such a row gives way, per unit of a row of the rank CLEARANCE, */
constexpr double BEND_GIVES_WAY = 10.0; /* and that of the chain's bend off the path: rather than let a body touch, */
/* Unless the bend takes this many times the accelerations: near singularities arms would part */
constexpr double BEND_GIVES_WAY_TO = 20.0;

/* uᵀ (∂_j J) w of an arm's n joints: a joint turns the joints after it, and those before it turn what it does. */
static void edge_gradient(const ArmColumns &near, const Vector6 &u, const double *w, int n, double *gradient) {
    const Vector3 force = u.head<3>(), moment = u.tail<3>();
    Vector3 before = Vector3::Zero(), after = Vector3::Zero();
    for (int j = n - 1; j >= 0; j--) {
        const Vector3 linear = near.col(j).head<3>(), turn = near.col(j).tail<3>();
        after += w[j] * linear.cross(force);
        gradient[j] = turn.dot(after);
        after += w[j] * turn.cross(moment);
    }
    for (int j = 0; j < n; j++) {
        const Vector3 linear = near.col(j).head<3>(), turn = near.col(j).tail<3>();
        gradient[j] += force.dot(before.cross(linear));
        before += w[j] * turn;
    }
}

/* The columns of the joints that move the tool of arm k, at a point `way` from that of the Jacobian. */
static ArmColumns columns_at(const Core *c, int k, const Vector3 &way) {
    ArmColumns near = columns_of_arm(c, k, c->jacobian);
    for (int j = 0; j < near.cols(); j++) near.col(j) = twist_at(near.col(j), way);
    return near;
}

/* The least singular value of one arm's tool Jacobian, at `way` from the point of J, and its gradient over the cell's joints. */
static double singular_edge(const Core *c, int k, const Vector3 &way, double *gradient) {
    const ArmColumns near = columns_at(c, k, way);
    const int n = (int)near.cols();
    Vector6 u = Vector6::Zero();
    double w[MOST_JOINTS], own[MOST_JOINTS], size = 0.0;
    if (n < 6) { /* uᵀ = (J w)ᵀ / σ */
        ArmVector least;
        size = sqrt(least_by_rotations(ArmSquare(near.transpose().lazyProduct(near)), &least));
        Eigen::Map<Eigen::VectorXd>(w, n) = least;
        if (size > 0.0) u = near.lazyProduct(least) / size;
    } else {
        least_by_rotations(Matrix6(near.lazyProduct(near.transpose())), &u);
        for (int j = 0; j < n; j++) w[j] = near.col(j).dot(u), size += w[j] * w[j];
        size = sqrt(size);
        for (int j = 0; j < n && size > 0.0; j++) w[j] /= size;
    }
    edge_gradient(near, u, w, n, own);
    for (int j = 0; j < n; j++) gradient[joint_behind(c, k, j)] = own[j];
    return size;
}

static Vector3 way_to_tool(const Core *c, int k);

/* The same of a group, about each arm's tool. */
static double group_edge(const Core *c, const Group &g, double *gradient) {
    ArmColumns near[MOST_SHARING];
    GroupColumns J = GroupColumns::Zero(6 * g.arms, g.joints);
    int place[MOST_SHARING][MOST_JOINTS]; /* of each arm's joints in the group */
    for (int i = 0, own = g.shared; i < g.arms; i++) {
        near[i] = columns_at(c, g.arm[i], way_to_tool(c, g.arm[i]));
        int n = 0;
        for (int j = 0; j < g.shared; j++)
            if (g.moves[i][j]) place[i][n++] = j;
        while (n < near[i].cols()) place[i][n++] = own++;
        for (int j = 0; j < n; j++) J.block<6, 1>(6 * i, place[i][j]) = near[i].col(j);
    }
    GroupTwists u = GroupTwists::Zero(J.rows());
    least_by_rotations(gram_of(J), &u);
    GroupVector w = J.transpose().lazyProduct(u);
    const double size = w.norm();
    if (size > 0.0) w /= size;
    for (int i = 0; i < g.arms; i++) {
        const int n = (int)near[i].cols();
        double mine[MOST_JOINTS], part[MOST_JOINTS];
        for (int j = 0; j < n; j++) mine[j] = w[place[i][j]];
        edge_gradient(near[i], u.segment<6>(6 * i), mine, n, part);
        for (int j = 0; j < n; j++) gradient[g.joint[place[i][j]]] += part[j];
    }
    return size;
}

static Vector6 bend(const Core *c, int k, const double *jacobian, const Vector &velocity) {
    const ArmColumns J = columns_of_arm(c, k, jacobian);
    const int n = (int)J.cols();
    double v[MOST_JOINTS];
    for (int j = 0; j < n; j++) v[j] = velocity[joint_behind(c, k, j)];
    Vector3 before = Vector3::Zero();
    Vector6 out = Vector6::Zero();
    for (int j = 0; j < n; j++) {
        const Vector3 linear = J.col(j).head<3>(), turn = v[j] * J.col(j).tail<3>();
        out.head<3>() += v[j] * (2.0 * before + turn).cross(linear);
        out.tail<3>() += before.cross(turn);
        before += turn;
    }
    return out;
}

/* How fast an edge with this room may come closer, that does so at a speed s and that accelerations change by `most`. */
static double edge_speed(double room, double s, double most, double h, double T) {
    room = max_of(room, 0.0), s = max_of(s, 0.0);
    const double a = EDGE_SHARE * max_of(s, most * h) / T;
    const double stopping = sqrt(a * h * (a * h) + 2.0 * a * room) - a * h;
    return max_of(min_of(room / max_of(APPROACH_TIME, APPROACH_STEPS * h), stopping), (1.0 - h / T) * s);
}

/* The largest speed of a joint in this step. */
static double reachable(const Core *c, int j, double h) {
    const double speed = fabs(c->velocity[j]);
    return min_of(max_of(speed, min_of(c->speed[j], speed + c->acceleration[j] * h)), FASTEST_JOINT);
}

/* Add a row whose numbers are in place, if an admissible velocity could break it. */
static void add_row(Core *c, double lower, double upper, int number, double soft = GIVES_WAY) {
    const int r = c->further_rows;
    c->further_lower[r] = lower, c->further_upper[r] = upper;
    c->further_soft[r] = soft, c->further_owner[r] = -1.0 - number;
    c->further_rows++;
}

static double *next_row(Core *c) {
    double *G = c->further + c->joints * c->further_rows;
    memset(G, 0, sizeof(double) * (size_t)c->joints);
    return G;
}

/* Where the tool of arm k is, from the object's origin as the first arm carries it. */
static Vector3 way_to_tool(const Core *c, int k) {
    const Pose &O = c->carried[k], &Y = c->object[k];
    return O.p - c->carried[0].p + O.R * (Y.R.transpose() * (c->tool_p.col(k) - Y.p));
}

/* The limit that a row stands for, by its number in BrakingRows.labels: kind, arm, joint, constraint. */
static void name_brake(const Core *c, int number, double *entry) {
    const int arms = c->arms, joints = c->joints;
    const int joint = number < arms ? -1 : number < arms + joints ? number - arms : number - arms - joints;
    entry[0] = joint < 0 ? SINGULARITY : number < arms + joints ? POSITION : ACCELERATION;
    entry[1] = joint < 0 ? number : -1.0;
    entry[2] = joint;
    entry[3] = -1.0;
}

/* Arms that give way have left their path, under acceleration limits. */
static bool gives_way(const Core *c) {
    return c->options->leaves_path && accelerates(c) && c->loop->corrects;
}

/* Add the rows that may bind the next velocities. */
static void brake_together(Core *c) {
    const double h = c->proposal->dt, most_bent = gives_way(c) ? BEND_OFF_PATH : BEND_SHARE;
    const Vector &v = c->velocity;
    Twists bends(c->scratch, 6, c->arms);
    Vector needed(c->scratch + 6 * c->arms, c->joints, 1), nothing(needed + c->joints, c->joints, 1);
    double T = h, size = 0.0;
    int worst = 0;
    for (int j = 0; j < c->joints; j++) T = max_of(T, fabs(v[j]) / c->plan_acceleration[j]);
    carry_and_linearise(c, c->positions, c->carried[0].p, nullptr, c->jacobian);
    needed.setZero();
    for (int k = 0; k < c->arms; k++) {
        if (!leads_group(c, k) || follows_way(c, k)) continue;
        const Group *g = group_of(c, k);
        double s = 0.0, most = 0.0, reach = 0.0, *G = next_row(c);
        const double sigma = g ? group_edge(c, *g, G) : singular_edge(c, k, way_to_tool(c, k), G);
        for (int i = 0; i < joints_together(c, k); i++) {
            const int j = joint_together(c, k, i);
            const double away = G[j];
            G[j] = -away;
            s -= away * v[j];
            most += fabs(away) * c->plan_acceleration[j];
            reach += fabs(away) * reachable(c, j, h);
        }
        const double upper = edge_speed(sigma - SINGULAR_MARGIN, s, most, h, T);
        if (reach > upper) add_row(c, -INFINITY, upper, k);
    }
    for (int j = 0; j < c->joints; j++) {
        const double x = c->positions[j], most = c->plan_acceleration[j];
        const double up = edge_speed(c->high[j] - x, v[j], most, h, T), down = edge_speed(x - c->low[j], -v[j], most, h, T);
        if (!(reachable(c, j, h) > min_of(up, down))) continue;
        next_row(c)[j] = 1.0;
        add_row(c, -down, up, c->arms + j);
    }
    for (int k = 0; k < c->arms; k++)
        bends.col(k) = bend(c, k, c->jacobian, v);
    const int singular = !two_velocities(c, c->jacobian, bends, Vector6::Zero(), nullptr, nullptr, needed, nothing);
    double used = singular ? INFINITY : 0.0, reach = 0.0, *G = next_row(c);
    for (int j = 0; j < c->joints && !singular; j++) {
        const double share = fabs(needed[j]) / c->plan_acceleration[j];
        if (share > used) used = share, worst = j;
    }
    for (int j = 0; j < c->joints; j++) {
        const double speed = isfinite(c->speed[j]) ? c->speed[j] : 1.0;
        G[j] = v[j] / (speed * speed);
        size += G[j] * v[j];
    }
    size = sqrt(size);
    if (!(used > 0.5 * most_bent) || !(size > 0.0)) return;
    for (int j = 0; j < c->joints; j++) {
        G[j] /= size;
        reach += fabs(G[j]) * reachable(c, j, h);
    }
    const double upper = max_of(sqrt(most_bent / used), 1.0 - h / T) * size;
    const bool soft = gives_way(c) && !c->proposal->hold && used <= BEND_GIVES_WAY_TO;
    if (reach > upper) add_row(c, -INFINITY, upper, c->arms + c->joints + worst, soft ? BEND_GIVES_WAY : GIVES_WAY);
}
