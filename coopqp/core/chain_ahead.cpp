/* The chain ahead of the clock: inverse kinematics and bounds of the rate at one clock, as a grid point. */

#include "ahead.h"

constexpr double FINE_CELL = 1e-3; /* intervals shorter than this are not halved for a change of slope [s], */
/* But for a change of q″ by more than this share, while the object takes longer for them */
constexpr double FINE_BEND = 0.05;
/* A slope that changes by more than this share within a fine interval is of another branch */
constexpr double OTHER_BRANCH = 0.5;
constexpr double BRANCH_WAY = 2.0; /* an arm this many joint steps from the end of its reach may be past it */
constexpr double FAR_EDGE = 1e3; /* the end of an arm's reach is no further than this, in units of its joints */
constexpr double FAR_PIVOT = 0.1; /* an arm whose smallest pivot is larger is far from the end of its reach, */
constexpr double FAR_ROOM = 0.02; /* where no joint needs more than this to there [rad or m] */
constexpr double EIGEN_ROUNDING = 1e-15; /* smallest pivot over the trace */
constexpr int EIGEN_STEPS = 3; /* of inverse iteration */
constexpr double BEND_CHANGE = 0.3; /* intervals are halved where q″ changes by more than this share of the accelerations */
/* Redundant arms come nearer to a given motion by this share per second of the clock [1/s] */
constexpr double ELBOW_GAIN = 5.0;
constexpr int MOST_TRIES = 4; /* Newton steps that a grid point may take */
constexpr int STARTING_STEPS = 8; /* Newton steps that the first grid point may take */
constexpr double CONVERGED = 1e-5; /* Newton steps shorter than this are the last [rad or m] */

struct Sketch {
    Pose *carried;
    Twists errors, w, jacobian;
    Vector step, reference, after;
};

static Sketch sketch_of(const Core *c) {
    const int n = c->arms, nv = c->joints;
    double *errors = c->sketch + 12 * n, *jacobian = errors + 12 * n, *step = jacobian + 6 * nv;
    return {reinterpret_cast<Pose *>(c->sketch), {errors, 6, n}, {errors + 6 * n, 6, n}, {jacobian, 6, nv},
            {step, nv, 1}, {step + nv, nv, 1}, {step + 2 * nv, nv, 1}};
}

/* Self-motion by which redundant arms keep clear of bodies; 0 if a constraint fails. */
static int evade(Core *c, const double *positions, double *slope) {
    Vector own(slope, c->joints, 1);
    if (!c->evade || (c->options->certified && quiet_ahead(c, positions))) return 1;
    c->evading_positions = Given(positions, c->joints);
    c->evading_slope = own;
    if (!c->evade(c)) return 0;
    own = c->evading_slope;
    return 1;
}

/* The motion of the elbows at a clock, which follows the path's numbers: joint j's position and speed. */
typedef struct {
    const double *x, *s;
    double h, u;
} ElbowPiece;

static ElbowPiece elbow_piece(const Core *c, double clock) {
    const double *numbers = c->path_numbers, *t = numbers + 3 + (int)numbers[1] + SEGMENT * (int)numbers[2];
    const int nodes = c->options->elbows, nv = c->joints;
    int i = 0;
    for (int n = nodes - 1; n > 1;) { /* the last grid point not after the clock, but the end of no piece */
        const int half = n / 2;
        if (t[i + half] <= clock) i += half, n -= half;
        else n = half;
    }
    const double h = t[i + 1] - t[i], *x = t + nodes + i * nv;
    return {x, x + nodes * nv, h, minimum(maximum((clock - t[i]) / h, 0.0), 1.0)};
}

static double elbow(const Core *c, ElbowPiece at, int j, double *speed) {
    const int nv = c->joints;
    const double h = at.h, u = at.u, way = at.x[nv + j] - at.x[j], a = at.s[j], b = at.s[nv + j];
    const double bend = 3.0 * way - h * (2.0 * a + b), twist = h * (a + b) - 2.0 * way;
    *speed = a + u * (2.0 * bend + 3.0 * u * twist) / h;
    return at.x[j] + u * (h * a + u * (bend + u * twist));
}

/* Whether the elbows go where they are led to, and not away from bodies. */
static int led(const Core *c) { return c->redundant && c->options->elbows > 0 && !c->evade; }

/* Velocities asked for in the null-space at a clock: along the motion of the elbows half a span later. */
static void elbow_velocity(const Core *c, double clock, double span, const double *positions, double *v) {
    const ElbowPiece at = elbow_piece(c, clock), later = elbow_piece(c, clock + 0.5 * span);
    for (int j = 0; j < c->joints; j++) {
        double speed;
        const double x = elbow(c, at, j, &speed);
        elbow(c, later, j, &speed);
        v[j] = speed + ELBOW_GAIN * wrapped(c, j, x - positions[j]);
    }
}

static void expect(const Core *c, int last, double span, double *x) {
    const Node *from = node(c, last);
    const double *x0 = vector_of(c, c->node_positions, last);
    if (led(c)) {
        const ElbowPiece then = elbow_piece(c, from->clock), now = elbow_piece(c, from->clock + span);
        const double pull = minimum(ELBOW_GAIN * span, 1.0);
        for (int j = 0; j < c->joints; j++) {
            double speed;
            const double before = elbow(c, then, j, &speed), after = elbow(c, now, j, &speed);
            x[j] = x0[j] + after - before + pull * wrapped(c, j, before - x0[j]);
        }
        return;
    }
    const double *slope = vector_of(c, c->node_slope, last), *curvature = vector_of(c, c->node_curvature, last);
    const double *bending = vector_of(c, c->node_bending, last);
    const double bends = !from->corner ? 0.5 * span : 0.0, bends_more = bends * (0.5 * from->span + span / 3.0);
    for (int j = 0; j < c->joints; j++)
        x[j] = x0[j] + (curvature[j] * bends + bending[j] * bends_more + slope[j]) * span;
}

/* Newton's step from `positions` to the pose at `clock`, and q′ there; where the twist jumps, that before it. */
static Trial newton_step(Core *c, double clock, double before, const double *positions, double *step, double *slope) {
    Sketch s = sketch_of(c);
    Pose T;
    Vector6 twist;
    double size = 0.0;
    const bool moving = grasps_move(c);
    const double then = maximum(minimum(clock, c->duration) - before, 0.0);
    if (!path_pose(c, clock, T) || !path_twist(c, then, twist)) return CANNOT_SAY;
    if (moving) place_grasps(c, minimum(clock, c->duration), c->ahead_shift), take_ways(c, then);
    carry_and_linearise(c, positions, T.p, s.carried, s.jacobian);
    if (!errors_at(c, s.carried, T, s.errors)) return REJECTED;
    for (int k = 0; k < c->arms; k++) s.w.col(k) = turned(T.R, -s.errors.col(k)); /* w_k = −R e_k */
    for (int k = 0; moving && k < c->arms; k++) c->own_world.col(k) = turned(T.R, twist + twist_on_object(c, k, then));
    if (c->redundant && c->options->elbows > 0) elbow_velocity(c, clock, 0.0, positions, s.reference);
    else if (c->redundant) posture_velocity(c, positions, s.reference);
    if (!two_velocities(c, s.jacobian, s.w, turned(T.R, twist), nullptr, c->redundant ? (double *)s.reference : nullptr, step,
                        slope, moving ? (double *)c->own_world : nullptr))
        return REJECTED;
    if (c->redundant && !evade(c, positions, slope)) return CANNOT_SAY;
    for (int k = 0; c->redundant && !(c->options->elbows > 0) && k < c->arms; k++)
        if (leads_group(c, k) && (joints_of(c, k).n > 6 || group_of(c, k))) lead_away(c, k, s.jacobian, positions, slope);
    if (moving) along_ways(c, clock, before, positions, step, slope);
    for (int j = 0; j < c->joints; j++) size += step[j] * step[j] + slope[j] * slope[j];
    return size < INFINITY ? FOUND : REJECTED;
}

/* Least eigenvalue of a symmetric, positive semidefinite matrix, and its eigenvector, by inverse iteration. */
template <typename Symmetric, typename Column>
static double least_eigenvalue(Symmetric G, Column *found) {
    const int n = Symmetric::RowsAtCompileTime < 0 ? (int)G.rows() : Symmetric::RowsAtCompileTime;
    const double trace = G.trace();
    double before = 1.0, size = 1.0, inverse[Symmetric::MaxRowsAtCompileTime];
    Column u;
    int least = 0;
    for (int i = 0; i < n; i++) { /* G = L D Lᵀ, L below the diagonal */
        for (int j = 0; j < i; j++)
            for (int k = 0; k < j; k++) G(i, j) -= G(i, k) * G(j, k) * inverse[k];
        for (int j = 0; j < i; j++) G(i, i) -= G(i, j) * G(i, j) * inverse[j];
        G(i, i) = maximum(G(i, i), EIGEN_ROUNDING * trace);
        inverse[i] = 1.0 / G(i, i); /* G(i, j) is an entry of L D */
        if (G(i, i) < G(least, least)) least = i;
    }
    u = Column::Unit(n, least);
    for (int iteration = 0; iteration < EIGEN_STEPS; iteration++) {
        before = size;
        for (int i = 0; i < n; i++) {
            for (int k = 0; k < i; k++) u[i] -= G(i, k) * u[k];
            u[i] *= inverse[i];
        }
        for (int i = n - 1; i >= 0; i--)
            for (int k = i + 1; k < n; k++) u[i] -= G(k, i) * inverse[i] * u[k];
        size = u.squaredNorm();
    }
    *found = u / sqrt(size);
    return sqrt(before / size);
}

/* uᵀ J′ v of an arm, J′ = Σ_j v_j ∂_j J, for joint motion `along` (n,). */
template <typename Columns>
static double slope_along(const Columns &J, const Vector6 &u, const double *along_joints) {
    Vector6 before = Vector6::Zero();
    double h = 0.0;
    for (int j = 0; j < J.cols(); j++) {
        const Vector6 own = J.col(j);
        const Vector3 v = own.template head<3>(), a = own.template tail<3>(), linear = before.head<3>();
        const Vector3 angular = before.tail<3>();
        const double along = along_joints[j];
        h += along * ((angular.cross(v) + linear.cross(a)).dot(u.head<3>()) + angular.cross(a).dot(u.tail<3>()));
        before += along * own;
    }
    return h;
}

/* The end of a reach, as a multiple of the motion that moves the object least. */
static double way_to_edge(double least, double h) {
    return -least / copysign(maximum(fabs(h), least * sqrt(least) / FAR_EDGE), h);
}

/* Joint motion that takes arm k to where its reach ends, to first order: Chain.to_reach_end. */
static void find_edge(const Core *c, int k, const Twists &jacobian, double *edge) {
    const ArmJoints &a = joints_of(c, k);
    double columns[6 * MOST_JOINTS], room[MOST_JOINTS], *own = place_for(a, edge, room);
    const OfArm J(side_by_side(a, jacobian, 6, columns), 6, a.n);
    Vector6 u;
    const double least = least_eigenvalue(Matrix6(J.lazyProduct(J.transpose())), &u);
    for (int j = 0; j < a.n; j++) own[j] = J.col(j).dot(u);
    const double way = way_to_edge(least, slope_along(J, u, own));
    for (int j = 0; j < a.n; j++) own[j] *= way;
    spread(a, own, edge);
}

/* The same of a group. */
static void find_group_edge(const Core *c, const Group &g, const Twists &jacobian, double *edge) {
    const GroupColumns J = stacked(c, g, jacobian);
    GroupTwists u = GroupTwists::Zero(J.rows());
    const double least = least_eigenvalue(gram_of(J), &u);
    const GroupVector along = J.transpose().lazyProduct(u);
    double h = 0.0;
    for (int j = 0; j < g.joints; j++) edge[g.joint[j]] = along[j];
    for (int i = 0; i < g.arms; i++) {
        const int k = g.arm[i], n = joints_behind(c, k);
        double own[MOST_JOINTS];
        for (int j = 0; j < n; j++) own[j] = edge[joint_behind(c, k, j)];
        h += slope_along(columns_of_arm(c, k, jacobian), u.segment<6>(6 * i), own);
    }
    const double way = way_to_edge(least, h);
    for (int j = 0; j < g.joints; j++) edge[g.joint[j]] *= way;
}

/* The edges of grid point i, from the Jacobians of the latest Newton step; those that are far need not be exact. */
static void find_edges(const Core *c, int i) {
    double *edges = edges_of(c, i);
    for (int k = 0; k < c->arms; k++) {
        const ArmJoints &a = joints_of(c, k);
        const Group *g = group_of(c, k);
        const auto none_near = [&] { for (int j = 0; j < a.n; j++) edges[a.own(j)] = FAR_EDGE; };
        if (follows_way(c, k) || (a.n < 6 && !g)) {
            none_near();
            continue;
        }
        bool far = c->least_pivot[k] > FAR_PIVOT && c->options->room <= FAR_ROOM;
        if (g) { /* its least eigenvalue is not less than any of its arms' */
            if (!leads_group(c, k)) continue;
            for (int m = 0; m < g->arms; m++) far &= c->least_pivot[g->arm[m]] > FAR_PIVOT;
            far |= g->joints < 6 * g->arms;
            for (int j = 0; far && j < g->joints; j++) edges[g->joint[j]] = FAR_EDGE;
            if (!far) find_group_edge(c, *g, sketch_of(c).jacobian, edges);
        } else if (far) {
            none_near();
        } else {
            find_edge(c, k, sketch_of(c).jacobian, edges);
        }
    }
}

/* The way of arm k, or of its group, to the end of its reach, as a multiple of what its joints need. */
static double room_of(const Core *c, int k, const double *edges) {
    double room = 0.0;
    for (int i = 0; i < joints_together(c, k); i++) {
        const int j = joint_together(c, k, i);
        room = maximum(room, fabs(edges[j]) / c->plan_room[j]);
    }
    return room;
}

/* The arm that is at the end of its reach at grid point i, or −1; of a group its first one. */
static int stretched_arm(const Core *c, int i) {
    double least = 2.0;
    int arm = -1;
    for (int k = 0; k < c->arms; k++) {
        const double room = room_of(c, k, edges_of(c, i));
        if (room < least) least = room, arm = k;
    }
    return arm;
}

/* Whether an arm comes too close to where its reach ends, or is past it. */
static int ends_reach(const Core *c, int last, int made) {
    const double *then = edges_of(c, last), *now = edges_of(c, made), near = BRANCH_WAY * c->options->joint_step;
    for (int k = 0; k < c->arms; k++) {
        if (!leads_group(c, k)) continue;
        const double room = room_of(c, k, now);
        double product = 0.0, largest = 0.0;
        if (room < 1.0 && room < room_of(c, k, then)) return 1;
        for (int i = 0; i < joints_together(c, k); i++) {
            const int j = joint_together(c, k, i);
            product += now[j] * then[j];
            largest = maximum(largest, maximum(fabs(now[j]), fabs(then[j])));
        }
        if (product < 0.0 && largest < near) return 1;
    }
    return 0;
}

/* The square of the most by which one joint alone would move the object faster than all together do, by the latest Jacobians:
 * near a singularity joints move against each other. It does not change with the path's clock. */
static double against_each_other(const Core *c, const double *slope) {
    Vector6 unit = Vector6::Ones();
    double most = 0.0;
    unit.tail<3>().setConstant(TURN_LENGTH);
    for (int k = 0; k < c->arms; k++) {
        if (follows_way(c, k)) continue;
        const ArmColumns J = columns_of_arm(c, k, sketch_of(c).jacobian);
        Vector6 together = Vector6::Zero();
        double alone = 0.0;
        for (int j = 0; j < J.cols(); j++) {
            const Vector6 own = slope[joint_behind(c, k, j)] * unit.cwiseProduct(J.col(j));
            together += own;
            alone = maximum(alone, own.squaredNorm());
        }
        if (alone > 0.0) most = maximum(most, alone / together.squaredNorm());
    }
    return most;
}

/* Bounds of grid point i from its positions and slope, and the slope of the grid point before (−1 for none); 0 if they overflow. */
static int bound_by_limits(Core *c, int before, int i, double clock, double span) {
    const Options *o = c->options;
    const double *slope = vector_of(c, c->node_slope, i), *x = vector_of(c, c->node_positions, i);
    const double *then = before < 0 ? slope : vector_of(c, c->node_slope, before);
    Node *k = node(c, i);
    double *curvature = vector_of(c, c->node_curvature, i), *bending = vector_of(c, c->node_bending, i);
    const double *bent = before < 0 ? curvature : vector_of(c, c->node_curvature, before);
    const int goes_on = before >= 0 && node(c, before)->span > 0.0 && !node(c, before)->corner;
    const double per = goes_on ? 2.0 / (span + node(c, before)->span) : 0.0;
    double fastest = 0.0, change = -INFINITY, by_speed = 0.0, by_bend = 0.0;
    int j_speed = 0, j_bend = 0, inside = 1;
    for (int j = 0; j < c->joints; j++) {
        curvature[j] = (slope[j] - then[j]) / span;
        bending[j] = per * (curvature[j] - bent[j]);
        const double bend = fabs(curvature[j]), speed = fabs(slope[j]);
        /* Use of the joint's limits at full rate: z is at most 1 over the speed's square, and 1 over the curvature's. */
        const double use_speed = speed * (1.0 / c->plan_speed[j]);
        const double use_bend = bend * (1.0 / (o->curvature_share * c->plan_acceleration[j]));
        fastest = maximum(fastest, fabs(slope[j]));
        change = maximum(change, bend * span - c->slope_change[j]);
        if (use_speed > by_speed) by_speed = use_speed, j_speed = j;
        if (use_bend > by_bend) by_bend = use_bend, j_bend = j;
        inside &= x[j] <= c->high[j] && x[j] >= c->low[j];
    }
    /* Without acceleration limits the step itself finds the cap by speed; below the cap by curvature it changes slowly. */
    const int capped = o->caps_speed;
    const double square = by_speed * by_speed, cap = 1.0 / maximum(capped ? square : by_bend, 1.0);
    *k = Node();
    k->clock = clock;
    k->span = before < 0 ? 0.0 : span;
    k->cap = cap;
    k->uncapped = 1.0 / maximum(maximum(square, by_bend), 1.0);
    if (k->uncapped < o->singular_rate * o->singular_rate)
        k->uncapped = maximum(k->uncapped, 1.0 / against_each_other(c, slope));
    k->fastest = fastest;
    k->slope_excess = change;
    k->inside = inside;
    k->fall = k->rise = k->line_from = INFINITY;
    name_cause(k->limit, NONE, -1, -1);
    name_cause(k->cause, NONE, -1, -1);
    const int j = capped ? j_speed : j_bend;
    if (cap < 1.0) name_cause(k->limit, capped ? VELOCITY : ACCELERATION, arm_of(c, j), j);
    return cap > 0.0;
}

/* Put a grid point under the further constraints; rejected if one allows no rate there: its number and the clock are kept. */
static Trial constrain(Core *c, int made) {
    Node *k = node(c, made);
    if (!c->bound_node) return FOUND;
    const double *x = vector_of(c, c->node_positions, made), *slope = vector_of(c, c->node_slope, made);
    if (c->options->certified && quiet_node(c, x, slope, vector_of(c, c->node_curvature, made), k->span))
        return FOUND;
    if (c->bound_node(c, place_of(c, made))) return FOUND;
    if (isnan(k->cap)) return CANNOT_SAY;
    c->ahead->blocked_by = 1 + k->limit.joint;
    c->ahead->blocked_at = k->clock;
    return REJECTED;
}

/* Whether q″ has changed by a small share of the accelerations between the intervals before two grid points; of fine ones, where
 * the object creeps. */
static int bends_slowly(const Core *c, int last, int made) {
    const Node *k = node(c, last);
    const double span = node(c, made)->span, cap = node(c, made)->cap;
    const double least = maximum(FINE_CELL * sqrt(cap), 2.0 * c->options->shortest);
    const int fine = span <= FINE_CELL;
    if (k->span == 0.0 || k->corner || (fine && !(span > least))) return 1;
    const double *bend = vector_of(c, c->node_curvature, made), *before = vector_of(c, c->node_curvature, last);
    double change = 0.0;
    for (int j = 0; j < c->joints; j++) change = maximum(change, fabs(bend[j] - before[j]) / c->plan_acceleration[j]);
    if (fine) return c->users_path || change * cap <= FINE_BEND; /* a user's path is asked rarely */
    return change <= BEND_CHANGE || change * largest_alone(c, made) <= BEND_CHANGE;
}

static Trial try_node(Core *c, int last, int made, double span, int iteration) {
    const Node *from = node(c, last);
    const Options *o = c->options;
    const double clock = from->clock + span;
    double *x = vector_of(c, c->node_positions, made), *step = sketch_of(c).step;
    if (iteration == 0) expect(c, last, span, x);
    const Trial found = newton_step(c, clock, JUST_BEFORE, x, step, vector_of(c, c->node_slope, made));
    if (found != FOUND) return found;
    const double largest = largest_size(step, c->joints);
    if (!(largest < o->joint_step)) return REJECTED;
    for (int j = 0; j < c->joints; j++) x[j] += step[j];
    if (!(largest < CONVERGED)) return iteration + 1 < MOST_TRIES ? PENDING : REJECTED;
    if (cannot_follow(c, sketch_of(c).errors)) {
        c->ahead->blind = true;
        return REJECTED;
    }
    if (!bound_by_limits(c, last, made, clock, span)) return REJECTED;
    const Node *k = node(c, made);
    if (span > o->shortest && !(span * k->fastest <= 1.5 * o->joint_step)) return REJECTED;
    const double most = span > FINE_CELL ? o->slope_step : OTHER_BRANCH;
    if (span > o->shortest && !(k->slope_excess <= most * k->fastest)) return REJECTED;
    if (!bends_slowly(c, last, made)) return REJECTED;
    find_edges(c, made);
    if (ends_reach(c, last, made)) return REJECTED;
    return constrain(c, made);
}

/* Largest σ² at which every joint can change its slope within one step; the joint that makes it. */
static double jump_cap(const Core *c, const double *after, const double *before, int *joint) {
    double least = INFINITY;
    *joint = 0;
    for (int j = 0; j < c->joints; j++) {
        const double jump = fabs((after ? after[j] : 0.0) - before[j]);
        if (!(jump > 1e-9) || !(c->plan_jump[j] / jump < least)) continue;
        least = c->plan_jump[j] / jump;
        *joint = j;
    }
    return least * least;
}

/* Where the twist jumps at grid point i: slopes after it, and the rate at which the joints can take the jump. */
static int turn_corner(Core *c, int i) {
    Sketch s = sketch_of(c);
    Node *k = node(c, i);
    double *slope = vector_of(c, c->node_slope, i);
    const double clock = k->clock + 1e-9, *x = vector_of(c, c->node_positions, i);
    const Trial found = newton_step(c, clock, JUST_BEFORE, x, s.step, s.after);
    if (found == CANNOT_SAY) return 0;
    if (found != FOUND) s.after.setZero();
    if (accelerates(c)) {
        int joint = 0;
        double fastest = 0.0;
        for (int j = 0; j < c->joints; j++) {
            const double use = fabs(s.after[j]) * (1.0 / c->plan_speed[j]);
            if (use > fastest) fastest = use, joint = j;
        }
        if (1.0 / maximum(fastest * fastest, 1.0) < k->cap) {
            k->cap = 1.0 / maximum(fastest * fastest, 1.0);
            name_cause(k->limit, VELOCITY, arm_of(c, joint), joint);
        }
        const double cap = jump_cap(c, s.after, slope, &joint);
        if (cap < k->cap) {
            k->cap = cap;
            name_cause(k->limit, ACCELERATION, arm_of(c, joint), joint);
        }
    }
    Vector(slope, c->joints, 1) = s.after;
    k->corner = true;
    k->fastest = largest_size(slope, c->joints);
    return 1;
}

/* Where the path ends moving the joints have one step to stop in. */
static int end_moving(Core *c) {
    const int last = c->ahead->count - 1;
    int joint;
    if (!accelerates(c)) return 0;
    const double cap = jump_cap(c, nullptr, vector_of(c, c->node_slope, last), &joint);
    if (!(cap < node(c, last)->cap)) return 0;
    copy_node(c, last, last + 1);
    node(c, last + 1)->cap = cap;
    node(c, last + 1)->span = 0.0;
    name_cause(node(c, last + 1)->limit, PATH_END, -1, -1);
    return 1;
}

/* Newton's method from x to a pose; the arm that does not get there, or −1. */
static int reach_pose(Core *c, const Pose &T, double *x) {
    Sketch s = sketch_of(c);
    double largest = INFINITY;
    int arm = 0;
    for (int i = 0; i <= STARTING_STEPS; i++) {
        carry_and_linearise(c, x, T.p, s.carried, s.jacobian);
        s.errors.setConstant(NAN);
        const int known = errors_at(c, s.carried, T, s.errors);
        largest = -1.0;
        for (int k = c->arms - 1; k >= 0; k--) {
            const double size = s.errors.col(k).allFinite() ? largest_size(s.errors.col(k).data(), 6) : INFINITY;
            if (size >= largest) largest = size, arm = k;
        }
        if (!known || largest <= 1e-10 || i == STARTING_STEPS) break;
        for (int k = 0; k < c->arms; k++) s.w.col(k) = turned(T.R, -s.errors.col(k));
        if (!two_velocities(c, s.jacobian, s.w, Vector6::Zero(), nullptr, nullptr, s.step, s.after)) break;
        const double length = largest_size(s.step, c->joints);
        const double share = length > LONGEST_STEP ? LONGEST_STEP / length : 1.0;
        Vector(x, c->joints, 1) += share * s.step;
    }
    return largest < 1e-6 ? -1 : arm;
}

/* The object rests there if the chain does not reach it. */
static int first_node(Core *c, double clock) {
    Pose T;
    Vector x(vector_of(c, c->node_positions, 0), c->joints, 1), slope(vector_of(c, c->node_slope, 0), c->joints, 1);
    if (!path_pose(c, clock, T)) return 0;
    if (grasps_move(c)) place_grasps(c, minimum(clock, c->duration), c->ahead_shift);
    x = c->positions;
    int arm = reach_pose(c, T, x);
    slope.setZero();
    c->ahead->blind = cannot_follow(c, sketch_of(c).errors);
    if (c->ahead->blind) arm = -1;
    if (arm >= 0) c->least_pivot.setZero();
    if (arm < 0) {
        const Trial found = newton_step(c, clock, 0.0, x, sketch_of(c).step, slope);
        if (found == CANNOT_SAY) return 0;
        if (found != FOUND) slope.setZero(), c->least_pivot.setZero();
    }
    find_edges(c, 0);
    bound_by_limits(c, -1, 0, clock, 1.0);
    if (arm < 0) return 1;
    node(c, 0)->cap = 0.0;
    name_cause(node(c, 0)->limit, REACH, arm, -1);
    return 1;
}
