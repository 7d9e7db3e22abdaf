/* The condensed QP of a step. With the arms' kinematics inverted, every admissible command of a perfect chain is
 *
 *     v = A⁻¹(σ ν + s) + ρ_g A⁻¹ c_k + ρ_p A⁻¹ c_p + v_0 (+ N z for redundant arms),
 *
 * so the unknowns are the off-path twist s (6), the path rate σ, the shares ρ_g and ρ_p of the grasp and path
 * corrections and z: nine plus the redundancy, whatever the number of arms, with a row per joint: v = base + columns x,
 * x = [s, cap − σ, 1 − ρ_g, 1 − ρ_p, z], each in the unit that makes its cost x². A least-distance problem. Where the
 * limits leave no answer each arm may part from the others by a twist of its own (6 arms), at a price above all else. */

#include "functions.h"

constexpr double AT_LIMIT = 1e-7; /* a velocity this close to its limit stands at it [rad/s or m/s] */
/* A solver's excess over a limit up to this is clipped; more is a failure [rad/s] */
constexpr double RESIDUE_TOLERANCE = 1e-5;

/* World twists of the object's six directions, and of ν, c_k, c_p and b_k. */
using TenTwists = Eigen::Matrix<double, 6, 10>;
/* Rows of joints, then further ones; columns of unknowns. */
using OfRows = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;

/* Of all joints of a group; z is the first of its null-space unknowns. */
static void group_columns(Core *c, const Group &g, int z, TenTwists T, double cap);

static OfRows columns_of(const Core *c) { return {c->columns, c->joints + c->further_rows, c->width}; }

/* Of one arm with n ≥ 6 joints, or of a group: the right inverse P (n, m) of J (m, n) of least Σ (v/scale)², and a basis
 * N (n, n − m) of the self-motions, orthonormal in the joints' units W. By Householder's QR of diag(W) Jᵀ. Returns false if
 * near a singularity. */
template <typename Columns, typename Units, typename TallRows, typename Whole>
static bool right_inverse(const Columns &J, const Units &W, TallRows &P, Whole &N) {
    constexpr int FIXED = TallRows::ColsAtCompileTime;
    const Eigen::Index n = J.cols();
    const int rows = FIXED < 0 ? (int)J.rows() : FIXED;
    TallRows M = W.asDiagonal() * J.transpose();
    Whole Q = Whole::Identity(n, n);
    Eigen::Matrix<double, FIXED, 1, 0, TallRows::MaxColsAtCompileTime, 1> diagonal(rows), per(rows);
    for (int i = 0; i < rows; i++) {
        auto reflector = M.col(i).tail(n - i); /* of squared length 2 |d M_ii| */
        const double length = reflector.norm();
        if (!(length > 0.0)) { /* a row of J that depends on those before */
            diagonal[i] = per[i] = 0.0;
            continue;
        }
        diagonal[i] = M(i, i) > 0.0 ? -length : length;
        M(i, i) -= diagonal[i];
        per[i] = -1.0 / (diagonal[i] * M(i, i));
        for (int m = i + 1; m < rows; m++) {
            auto column = M.col(m).tail(n - i);
            column -= reflector.dot(column) * per[i] * reflector;
        }
        const Eigen::Matrix<double, Eigen::Dynamic, 1, 0, Whole::MaxRowsAtCompileTime, 1> along =
            Q.rightCols(n - i).lazyProduct(reflector);
        for (Eigen::Index m = i; m < n; m++) Q.col(m) -= per[i] * M(m, i) * along;
    }
    P.resize(n, rows);
    for (int i = rows - 1; i >= 0; i--) { /* P = diag(W) Q₁ R⁻ᵀ */
        P.col(i) = Q.col(i);
        for (int m = i + 1; m < rows; m++) P.col(i) -= M(i, m) * P.col(m);
        P.col(i) /= diagonal[i];
    }
    P = W.asDiagonal() * P;
    N = W.asDiagonal() * Q.rightCols(n - rows);
    return P.allFinite() && P.cwiseAbs().maxCoeff() < LARGE_INVERSE;
}

/* right_inverse, or near a singularity and of few joints the floored one; N are self-motions. */
template <typename Columns, typename Units, typename TallRows, typename Whole>
static void any_inverse(const Columns &J, const Units &W, TallRows &P, Whole &N) {
    if (J.cols() < J.rows()) N.resize(J.cols(), 0);
    else if (right_inverse(J, W, P, N)) return;
    floored_inverse<Whole>(J, W, P);
}

/* Columns of the twists by which arm k parts, of joints that move at P w for a world twist w of it. */
template <typename Rows6>
static void put_parting(Core *c, int k, int joint, int row, const Rows6 &P) {
    const Matrix3 &R = c->pose->R;
    auto own = columns_of(c).row(joint).segment<6>(c->unknowns + 6 * k);
    const Eigen::RowVector3d linear = P.row(row).template head<3>() * R, angular = P.row(row).template tail<3>() * R;
    own.head<3>() = c->options->part_unit * linear;
    own.tail<3>() = c->options->part_unit * c->unit[3] / c->unit[0] * angular;
}

/* The chain may part: the columns are for that. */
static bool may_part(const Core *c) { return c->width > c->unknowns; }

/* Unit of self-motions. */
static double self_motion_unit(const Core *c, int z) { return may_part(c) ? c->options->calm_unit : c->unit[z]; }

/* Base and columns of a joint, from its rows of the velocities for the ten twists, and of self-motions, whose unknowns begin at z. */
template <typename TenVelocities, typename SelfMotions>
static void put_joint(Core *c, int joint, const TenVelocities &x, const SelfMotions &n, int z, double cap) {
    const Given unit(c->unit, c->unknowns);
    auto row = columns_of(c).row(joint);
    row.setZero();
    row.template head<6>() = x.template head<6>().cwiseProduct(unit.head<6>().transpose());
    row.template segment<3>(6) = -x.template segment<3>(6).cwiseProduct(unit.segment<3>(6).transpose());
    if (n.size()) row.segment(z, n.size()) = self_motion_unit(c, z) * n;
    c->base[joint] = x[9] + x[7] + x[8] + cap * x[6];
}

/* Rows of base and columns of one arm; z is the first of its null-space unknowns. */
static void arm_columns(Core *c, int k, int z, const TenTwists &T, double cap) {
    const ArmJoints &a = joints_of(c, k);
    double columns[6 * MOST_JOINTS], room[3][MOST_JOINTS];
    const OfArm J(side_by_side(a, c->jacobian, 6, columns), 6, a.n);
    const auto own = [&](const double *of, double *place) { return Given(side_by_side(a, of, 1, place), a.n); };
    const Given scale = own(c->scale, room[0]);
    ArmRows6 P;
    ArmSquare N;
    any_inverse(ArmColumns(J), scale, P, N);
    Eigen::Matrix<double, Eigen::Dynamic, 10, 0, MOST_JOINTS, 10> X = P.lazyProduct(T);
    if (a.n > 6) { /* the null-space references' coordinates in the null-space */
        const ArmSquare per = scale.cwiseAbs2().cwiseInverse().asDiagonal() * N;
        const ArmVector along = per.transpose().lazyProduct(own(c->null_along, room[1]));
        const ArmVector rest = per.transpose().lazyProduct(own(c->null_offset, room[2]));
        X.col(6) += N.lazyProduct(along);
        X.col(9) += N.lazyProduct(rest);
    }
    for (int i = 0; i < a.n; i++) {
        put_joint(c, a.own(i), X.row(i), N.row(i), z, cap);
        if (may_part(c)) put_parting(c, k, a.own(i), i, P);
    }
}

/* Fill base and columns, of joints and further rows, of a chain that may part or not. False where a number is not finite. */
static bool condense(Core *c, double cap, bool parts) {
    c->width = c->unknowns + (parts ? 6 * c->arms : 0);
    const Matrix3 &R = c->pose->R;
    const int joints = c->joints, all = joints + c->further_rows;
    TenTwists T = TenTwists::Zero();
    Vector base(c->base, all, 1);
    OfRows columns = columns_of(c);
    int z = TWIST_AND_SHARES;
    if (some_have_few(c))
        for (int i = 0; i < 6; i++) T.col(i) = turned(R, admitted_twist(c, i)) / c->unit[i];
    else
        T.block<3, 3>(0, 0) = T.block<3, 3>(3, 3) = R;
    T.col(6) = turned(R, c->along);
    T.col(8) = turned(R, c->path);
    base.head(joints).setZero(), columns.topRows(joints).setZero(); /* joints that no arm moves stand still */
    for (int k = 0; k < c->arms; k++) {
        if (const Group *g = group_of(c, k)) {
            if (!leads_group(c, k)) continue;
            group_columns(c, *g, z, T, cap);
            z += std::max(g->joints - 6 * g->arms, 0);
            continue;
        }
        const ArmJoints &a = joints_of(c, k);
        const int first = z;
        z += std::max(a.n - 6, 0);
        for (int i = 0; follows_way(c, k) && i < a.n; i++) {
            const int j = a.own(i);
            base[j] = cap * c->null_along[j] + c->null_offset[j];
            columns(j, 6) = -c->unit[6] * c->null_along[j];
        }
        if (follows_way(c, k)) continue;
        if (grasps_move(c)) T.col(6) = turned(R, c->own_along.col(k));
        T.col(7) = turned(R, c->grasp.col(k));
        T.col(9) = turned(R, c->offsets.col(k));
        arm_columns(c, k, first, T, cap);
    }
    for (int r = 0; r < c->further_rows; r++) {
        const Eigen::Map<const Eigen::RowVectorXd> G(c->further + joints * r, joints);
        base[joints + r] = G.dot(base.head(joints));
        columns.row(joints + r) = G.lazyProduct(columns.topRows(joints));
    }
    return isfinite(base.squaredNorm() + columns.squaredNorm());
}

/* What put_row() divides a row by. */
static double row_length(const Core *c, int from, double unit) {
    const double square = columns_of(c).row(from).squaredNorm() + unit * unit;
    return square < 1e-24 ? 1.0 : sqrt(square);
}

/* One row of the least-distance problem, scaled to unit norm: lower ≤ base + columns x − unit t ≤ upper, t unknown `slack`
 * (none for −1). */
static void put_row(const Core *c, int from, int width, int slack, double unit, double lower, double upper, double *row,
                    double *low, double *high) {
    const auto columns = columns_of(c).row(from);
    const double per = 1.0 / row_length(c, from, slack >= 0 ? unit : 0.0);
    Eigen::Map<Eigen::RowVectorXd> out(row, width);
    out << per * columns, Eigen::RowVectorXd::Zero(width - c->width);
    if (slack >= 0) row[slack] = -unit * per;
    *low = (lower - c->base[from]) * per;
    *high = (upper - c->base[from]) * per;
}

/* Solve the condensed QP by the core's own method. With `relax`, soft further rows may give way. Fills x and `pull`, and
 * returns the iterations, or a negative number. */
static int solve_condensed(Core *c, double cap, int relax) {
    const int rows = c->joints + c->further_rows;
    int outside = 0, n = c->width, m = 0, soft = 0;
    for (int j = 0; j < c->joints; j++) outside += c->outside[j] != 0.0;
    for (int r = 0; relax && r < c->further_rows; r++) soft += c->further_soft[r] != 0.0;
    n += outside + soft;
    const int most = outside + rows;
    double *A = c->scratch, *low = A + n * most, *high = low + most, *lb = high + most, *ub = lb + n, *y = ub + n;
    for (int i = 0; i < n; i++) lb[i] = -INFINITY, ub[i] = INFINITY;
    for (int i = 6; i < 9; i++) lb[i] = 0.0, ub[i] = (i == 6 ? cap : 1.0) / c->unit[i];
    int slack = c->width;
    for (int j = 0; j < c->joints; j++)
        if (c->outside[j] != 0.0) {
            put_row(c, j, n, slack++, c->options->recovery_unit, c->recovery[j], c->recovery[j], A + n * m, low + m,
                    high + m);
            m++;
        }
    for (int j = 0; j < c->joints; j++, m++)
        put_row(c, j, n, -1, 0.0, c->lower[j], c->upper[j], A + n * m, low + m, high + m);
    for (int r = 0; r < c->further_rows; r++, m++) {
        const int gives_way = relax && c->further_soft[r] != 0.0;
        put_row(c, c->joints + r, n, gives_way ? slack++ : -1, c->options->relax_unit * c->further_soft[r],
                c->further_lower[r], c->further_upper[r], A + n * m, low + m, high + m);
    }
    const int iterations = least_distance(n, m, A, low, high, lb, ub, LARGEST_X, c->x, y, y + m + n);
    for (int j = 0; j < c->joints; j++) c->pull[j] = y[outside + j] / row_length(c, j, 0.0);
    for (int j = 0, i = 0; j < c->joints; j++)
        if (c->outside[j] != 0.0) c->pull[j] += y[i++] / row_length(c, j, c->options->recovery_unit);
    return iterations;
}

/* The step that a solution stands for: command, rate, shares and off-path twist, and the limits at which it stands.
 * 0 if its excess over a limit is more than a solver's residue. */
static int read_answer(Core *c, double cap) {
    Proposal *p = c->proposal;
    int count = 0;
    const Given base(c->base, c->joints), x(c->x, c->width);
    c->command = base + columns_of(c).topRows(c->joints).lazyProduct(x);
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < c->joints + c->further_rows; i++) {
            const int own = i >= c->joints;
            const double v = own ? further(c, i - c->joints, c->command) : c->command[i];
            const double lower = own ? c->further_lower[i - c->joints] : c->lower[i];
            const double upper = own ? c->further_upper[i - c->joints] : c->upper[i];
            const double excess = pass ? lower - v : v - upper;
            const int soft = own && c->further_soft[i - c->joints] != 0.0;
            if (!(excess <= RESIDUE_TOLERANCE) && !(soft && p->relaxed)) return 0;
            if (fabs(excess) > AT_LIMIT && !(own && excess > 0.0)) continue;
            c->bindings[2 * count] = i;
            c->bindings[2 * count++ + 1] = pass ? -1.0 : 1.0;
        }
    p->bindings = count;
    for (int j = 0; j < c->joints; j++) c->command[j] = clamp(c->command[j], c->lower[j], c->upper[j]);
    c->off_path.setZero();
    for (int i = 0; i < 6; i++)
        if (some_have_few(c)) c->off_path += c->x[i] * admitted_twist(c, i);
        else c->off_path[i] = c->x[i] * c->unit[i];
    p->new_rate = clamp(cap - c->x[6] * c->unit[6], 0.0, cap); /* a solver may miss its bounds a little */
    p->grasp_share = 1.0 - c->x[7] * c->unit[7];
    p->path_share = 1.0 - c->x[8] * c->unit[8];
    return 1;
}
