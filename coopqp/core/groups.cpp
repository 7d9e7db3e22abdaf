/* Arms that share joints: a group is one redundant arm, whose tools are those of all of them. See
 * "Joints that arms share" in docs/derivations.md. */

#include "functions.h"

constexpr double WELL_INVERTED = 1e-3; /* smallest pivot of an arm that shares joints, whose own inverse serves */

/* Rows of all tools, columns of all joints of a group. */
using GroupVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, MOST_GROUP_JOINTS, 1>;
using GroupTwists = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 6 * MOST_SHARING, 1>;
using GroupColumns = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 6 * MOST_SHARING, MOST_GROUP_JOINTS>;
using GroupRows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, MOST_GROUP_JOINTS, 6 * MOST_SHARING>;
using GroupSquare = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, MOST_GROUP_JOINTS, MOST_GROUP_JOINTS>;

using GroupGram = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 6 * MOST_SHARING, 6 * MOST_SHARING>;

/* J of a group (6 arms, joints): that of all its arms, one below the other. */
static GroupColumns stacked(const Core *c, const Group &g, const double *jacobian) {
    GroupColumns J = GroupColumns::Zero(6 * g.arms, g.joints);
    for (int i = 0, own = g.shared; i < g.arms; i++) {
        const int n = joints_of(c, g.arm[i]).n;
        const auto put = [&](int j) { J.block<6, 1>(6 * i, j) = Eigen::Map<const Vector6>(jacobian + 6 * g.joint[j]); };
        for (int j = 0; j < g.shared; j++)
            if (g.moves[i][j]) put(j);
        for (int j = own; j < own + n; j++) put(j);
        own += n;
    }
    return J;
}

/* J Jᵀ */
static GroupGram gram_of(const GroupColumns &J) {
    GroupGram G = GroupGram::Zero(J.rows(), J.rows());
    G = J.lazyProduct(J.transpose());
    return G;
}

/* The group's part of numbers of all joints; zeros for nullptr. */
static GroupVector gathered(const Group &g, const double *of) {
    GroupVector out = GroupVector::Zero(g.joints);
    for (int j = 0; of && j < g.joints; j++) out[j] = of[g.joint[j]];
    return out;
}

/* What group_velocities was given, a pair of each: twists and null-space references, nullptr for none. */
struct TwoWishes {
    const double *w[2], *u[2];
    bool own; /* the second twist, too, is of each arm */

    /* The twist of arm k. */
    Vector6 twist(int side, int k) const {
        if (!w[side]) return Vector6::Zero();
        return Eigen::Map<const Vector6>(w[side] + (side == 0 || own ? 6 * k : 0));
    }
};

/* Columns of one arm's own joints: two velocities without the shared joints, t, then by how much one of each takes away, C. */
typedef double OwnColumns[2 + MOST_SHARED][MOST_JOINTS];
typedef double SharedSquare[MOST_SHARED][MOST_SHARED];
typedef double SharedPair[MOST_SHARED][2];

static inline double dot(const double *a, const double *b, int n) {
    double sum = 0.0;
    for (int j = 0; j < n; j++) sum += a[j] * b[j];
    return sum;
}

/* t and C of a group's arm m, A⁺ [w₀ w₁ B] near its null-space references, B the columns of the shared joints that move its tool; their part of
 * S and x. For so many shared, and own joints, 0 for any number. False if the arm is near a singularity. */
template <int SHARED, int OWN>
static bool add_arm(Core *c, const Group &g, int m, const double *jacobian, const TwoWishes &given, OwnColumns &X,
                    SharedSquare &S, SharedPair &x) {
    constexpr int PAIRS = 1 + ((SHARED > 0 ? SHARED : MOST_SHARED) + 1) / 2;
    const int k = g.arm[m], shared = SHARED > 0 ? SHARED : g.shared;
    const ArmJoints &joints = joints_of(c, k);
    const int n = OWN > 0 ? OWN : joints.n;
    double columns[6 * MOST_JOINTS], room[3][MOST_JOINTS];
    const double *own = side_by_side(joints, jacobian, 6, columns), *scale = side_by_side(joints, c->scale, 1, room[2]);
    const double *references[2];
    for (int side = 0; side < 2; side++)
        references[side] = given.u[side] ? side_by_side(joints, given.u[side], 1, room[side]) : nullptr;
    Vector6 twists[2] = {given.twist(0, k), given.twist(1, k)};
    ArmColumns weighted;
    Rows<PAIRS> A;
    const auto put = [&A](int i, int column, double value) { A[i][column / 2][column % 2] = value; };
    if constexpr (OWN != 6) {
        const OfArm J(own, 6, n);
        weighted = J * Given(scale, n).cwiseAbs2().asDiagonal();
        gram6<PAIRS>(own, scale, n, A);
        for (int side = 0; side < 2; side++)
            if (references[side]) twists[side] -= J.lazyProduct(Given(references[side], n));
    }
    for (int i = 0; i < 6; i++) {
        for (int j = 0; OWN == 6 && j < 6; j++) put(i, j, own[6 * j + i]);
        A[i][3] = pair{twists[0][i], twists[1][i]};
        for (int j = 0; j < 2 * PAIRS - 2; j++) put(i, 8 + j, j < shared && g.moves[m][j] ? jacobian[6 * g.joint[j] + i] : 0.0);
    }
    const double least = OWN == 6 ? solve6<PAIRS>(A) : solve_gram6<PAIRS>(A);
    c->least_pivot[k] = OWN == 6 ? least : sqrt(least);
    if (!(least > WELL_INVERTED)) return false;
    for (int b = 0; b < 2 + shared; b++) {
        if constexpr (OWN == 6) {
            for (int j = 0; j < 6; j++) X[b][j] = A[j][3 + b / 2][b % 2];
        } else {
            Vector6 y;
            for (int i = 0; i < 6; i++) y[i] = A[i][3 + b / 2][b % 2];
            Eigen::Map<Eigen::VectorXd> column(X[b], n);
            column = weighted.transpose().lazyProduct(y);
            if (b < 2 && references[b]) column += Given(references[b], n);
        }
    }
    for (int a = 0; a < shared; a++) {
        double along[MOST_JOINTS];
        for (int j = 0; j < n; j++) along[j] = X[2 + a][j] / (scale[j] * scale[j]);
        for (int b = 0; b <= a; b++) S[a][b] += dot(along, X[2 + b], n);
        for (int side = 0; side < 2; side++)
            x[a][side] += dot(along, X[side], n) - (references[side] ? dot(along, references[side], n) : 0.0);
    }
    return true;
}

/* x with S x = b for two b, of few unknowns; S, of which the lower half is given, is positive definite. */
static inline void solve_shared(SharedSquare &S, SharedPair &b, int n) {
    for (int i = 0; i < n; i++) /* S = L D Lᵀ: L D below the diagonal, D⁻¹ on it */
        for (int j = 0; j <= i; j++) {
            for (int m = 0; m < j; m++) S[i][j] -= S[i][m] * S[j][m] * S[m][m];
            if (i == j) S[i][i] = 1.0 / S[i][i];
        }
    for (int side = 0; side < 2; side++) {
        for (int i = 0; i < n; i++)
            for (int m = 0; m < i; m++) b[i][side] -= S[i][m] * S[m][m] * b[m][side];
        for (int i = n - 1; i >= 0; i--) {
            for (int m = i + 1; m < n; m++) b[i][side] -= S[m][i] * b[m][side];
            b[i][side] *= S[i][i];
        }
    }
}

/* v_k = t_k − C_k v_s */
template <int SHARED, int OWN>
static void put_arm(const Core *c, const Group &g, int k, const OwnColumns &X, const SharedPair &x, double *const v[2]) {
    const ArmJoints &joints = joints_of(c, k);
    const int n = OWN > 0 ? OWN : joints.n, shared = SHARED > 0 ? SHARED : g.shared;
    for (int side = 0; side < 2; side++) {
        double own[MOST_JOINTS];
        for (int j = 0; j < n; j++) own[j] = X[side][j];
        for (int a = 0; a < shared; a++)
            for (int j = 0; j < n; j++) own[j] -= X[2 + a][j] * x[a][side];
        for (int j = 0; j < n; j++) v[side][joints.own(j)] = own[j];
    }
}

/* By each arm's own inverse: v_k = t_k − C_k v_s, and (D⁻² + Σ Cᵀ D⁻² C) v_s = D⁻² u_s + Σ Cᵀ D⁻² (t − u). False if an arm
 * is near a singularity. */
template <int SHARED>
static bool arm_by_arm(Core *c, const Group &g, const double *jacobian, const TwoWishes &given, double *const v[2]) {
    OwnColumns X[MOST_SHARING];
    SharedSquare S;
    SharedPair x;
    for (int a = 0; a < g.shared; a++) {
        const double unit = c->scale[g.joint[a]], per = 1.0 / (unit * unit);
        for (int b = 0; b < a; b++) S[a][b] = 0.0;
        S[a][a] = per;
        for (int side = 0; side < 2; side++) x[a][side] = given.u[side] ? per * given.u[side][g.joint[a]] : 0.0;
    }
    for (int i = 0; i < g.arms; i++) {
        if (!(joints_of(c, g.arm[i]).n == 6 ? add_arm<SHARED, 6>(c, g, i, jacobian, given, X[i], S, x)
                                            : add_arm<SHARED, 0>(c, g, i, jacobian, given, X[i], S, x)))
            return false;
    }
    solve_shared(S, x, SHARED > 0 ? SHARED : g.shared);
    for (int side = 0; side < 2; side++)
        for (int a = 0; a < g.shared; a++) v[side][g.joint[a]] = x[a][side];
    for (int i = 0; i < g.arms; i++) {
        if (joints_of(c, g.arm[i]).n == 6) put_arm<SHARED, 6>(c, g, g.arm[i], X[i], x, v);
        else put_arm<SHARED, 0>(c, g, g.arm[i], X[i], x, v);
    }
    return true;
}

/* By the inverse of them all: an arm may be at a singularity where its group is not. */
static bool all_at_once(Core *c, const Group &g, const double *jacobian, const TwoWishes &given, double *const v[2]) {
    const GroupColumns J = stacked(c, g, jacobian);
    GroupRows P;
    GroupSquare N;
    GroupTwists left(6 * g.arms);
    if (J.cols() < J.rows()) any_inverse(J, gathered(g, c->scale), P, N);
    else if (!right_inverse(J, gathered(g, c->scale), P, N)) return false;
    for (int side = 0; side < 2; side++) {
        const GroupVector references = gathered(g, given.u[side]);
        for (int i = 0; i < g.arms; i++) left.segment<6>(6 * i) = given.twist(side, g.arm[i]);
        left -= J.lazyProduct(references);
        const GroupVector found = references + P.lazyProduct(left);
        for (int j = 0; j < g.joints; j++) v[side][g.joint[j]] = found[j];
    }
    for (int i = 0; i < g.arms; i++) c->least_pivot[g.arm[i]] = 0.0;
    return true;
}

static int group_velocities(Core *c, const Group &g, const double *jacobian, const double *w0, const double *w1, bool own,
                            const double *u0, const double *u1, double *v0, double *v1) {
    const TwoWishes given = {{w0, w1}, {u0, u1}, own};
    double *const v[2] = {v0, v1};
    const bool found = g.by_arms && (g.shared == 1 ? arm_by_arm<1>(c, g, jacobian, given, v) : arm_by_arm<0>(c, g, jacobian, given, v));
    return found || all_at_once(c, g, jacobian, given, v);
}

/* Rows of base and columns of a group, as arm_columns; T has ν, and c_p and the object's directions, which all arms share. */
static void group_columns(Core *c, const Group &g, int z, TenTwists T, double cap) {
    const Matrix3 &R = c->pose->R;
    const GroupVector scale = gathered(g, c->scale);
    GroupRows P;
    GroupSquare N;
    Eigen::Matrix<double, Eigen::Dynamic, 10, 0, 6 * MOST_SHARING, 10> all(6 * g.arms, 10);
    for (int i = 0; i < g.arms; i++) {
        T.col(7) = turned(R, c->grasp.col(g.arm[i]));
        T.col(9) = turned(R, c->offsets.col(g.arm[i]));
        all.middleRows<6>(6 * i) = T;
    }
    any_inverse(stacked(c, g, c->jacobian), scale, P, N);
    Eigen::Matrix<double, Eigen::Dynamic, 10, 0, MOST_GROUP_JOINTS, 10> X = P.lazyProduct(all);
    const GroupSquare per = scale.cwiseAbs2().cwiseInverse().asDiagonal() * N;
    const GroupVector along = per.transpose().lazyProduct(gathered(g, c->null_along));
    const GroupVector rest = per.transpose().lazyProduct(gathered(g, c->null_offset));
    X.col(6) += N.lazyProduct(along);
    X.col(9) += N.lazyProduct(rest);
    for (int i = 0; i < g.joints; i++) {
        put_joint(c, g.joint[i], X.row(i), N.row(i), z, cap);
        for (int k = 0; may_part(c) && k < g.arms; k++)
            put_parting(c, g.arm[k], g.joint[i], i, P.template middleCols<6>(6 * k));
    }
}
