/* The closed chain: errors, corrections, and joint velocities from twists of the object.
 *
 * With E_k = R⁻¹ O_k an arm's view from the reference, a twist ν in the axes of R leads it to exp(h ν) E_k in a time h.
 * log E_k does not change by h ν then, but by J⁻¹ h ν with the exponential's left Jacobian J at log E_k. What a step
 * foresees for the next one would be wrong by (1 − J⁻¹) h ν, which from a turn of 109° on is more than h ν itself:
 * errors would grow from step to step, and the arms part. So where the object is turned by more than FAR_OFF the errors
 * are
 *
 *     e_1 = log E_1,    e_k = e_1 + log(E_k E_1⁻¹),
 *
 * and what all arms have in common is followed by exponentials. Nearer to the path they are the logarithms, which do not
 * depend on the order of the arms, and what they miss of the twists dies away. */

#include "functions.h"

constexpr double SMALLEST_PIVOT = 1e-9; /* smallest pivot over the largest entry */
constexpr double LONG_LEVER = 3.0; /* an arm further from the object's origin is inverted about a point of its own [m] */
constexpr double FAR_OFF = 1.0; /* an object that is turned further off its path has errors that differ by twists [rad] */
constexpr int MOST_SWEEPS = 12; /* of Jacobi's rotations */
constexpr double SMALL_ROTATION = 1e-16; /* entries this small over the trace need none */

/* -- errors and corrections ------------------------------------------------------------------------------------------ */

static int errors_at(const Core *c, const Pose *carried, const Pose &T, Twists &errors) {
    for (int k = 0; k < c->arms; k++) errors.col(k) = any_log6(between(T, carried[k]));
    return errors.allFinite();
}

/* The object is turned so far off its path that logarithms of the arms' views do not differ by twists. */
static bool far_off(const Vector6 &error) { return !(error.tail<3>().squaredNorm() < FAR_OFF * FAR_OFF); }

static int view_errors(const Core *c, const Pose *carried, Twists &errors) {
    const bool commanded = carried == c->carried;
    if (commanded && !errors_at(c, carried, *c->pose, errors)) return 0;
    if (!far_off(c->errors.col(0))) return commanded || errors_at(c, carried, *c->pose, errors);
    const Pose first = between(*c->pose, c->carried[0]);
    const Vector6 common = any_log6(first);
    for (int k = 0; k < c->arms; k++) {
        errors.col(k) = common + any_log6(from_to(first, between(*c->pose, carried[k])));
    }
    return errors.allFinite();
}

/* What the first view's errors later are beyond the sum of its errors and of a way from there. */
static Vector6 bend_of_way(const Vector6 &error, const Vector6 &way) {
    if (!far_off(error)) return Vector6::Zero();
    return any_log6(compose(exp6(way), exp6(error))) - error - way;
}

/* What the first view's way between errors is beyond their difference. */
static Vector6 bend_of_errors(const Vector6 &error, const Vector6 &later) {
    if (!far_off(error)) return Vector6::Zero();
    return any_log6(from_to(exp6(error), exp6(later))) - (later - error);
}

static Vector6 common_error(const Core *c, const Twists &errors) {
    Vector6 common = Vector6::Zero();
    for (int k = 0; k < c->arms; k++) common += c->shares.col(k).cwiseProduct(errors.col(k));
    return common;
}

/* Shrink n corrections by one common factor to the bounds of speed and spin. */
static double bound(const Core *c, double *twists, int n) {
    Eigen::Map<Matrix6X> of(twists, 6, n);
    const double speed = c->options->correction_speed, spin = c->options->correction_spin;
    double linear = 0.0, angular = 0.0;
    for (int k = 0; k < n; k++) {
        linear = max_of(linear, of.col(k).head<3>().squaredNorm());
        angular = max_of(angular, of.col(k).tail<3>().squaredNorm());
    }
    if (!(linear > speed * speed) && !(angular > spin * spin)) return 1.0;
    const double excess = maximum(sqrt(max_of(linear / (speed * speed), angular / (spin * spin))), 1.0);
    of *= 1.0 / excess;
    return excess;
}

/* Whether the grasps were asked to shift since the step before, by `asked_shift`, of which the errors foreseen did not know. */
static bool asked_to_shift(const Core *c) { return c->loop->has_predicted && c->loop->has_asked_shift; }

/* c_k, c_p, and b_k: the error of the last linearisation; beyond what that step foresaw it is left over. Gains take away
 * no more than the whole error in a step. What was asked of the grasps is no error: it is made up for in this step. */
static void corrections(Core *c, double h) {
    const double grasp_gain = min_of(c->options->grasp_gain, 1.0 / h), path_gain = min_of(c->options->path_gain, 1.0 / h);
    const bool asked = asked_to_shift(c), predicted = c->loop->has_predicted;
    const double per_step = 1.0 / c->loop->last_dt;
    c->common = common_error(c, c->errors);
    const Vector6 bend = predicted ? bend_of_errors(c->errors.col(0), c->predicted.col(0)) : Vector6::Zero();
    const Vector6 common_shift = asked ? common_error(c, c->asked_shift) : Vector6::Zero();
    for (int k = 0; k < c->arms; k++) {
        Vector6 e = c->errors.col(k), shift = Vector6::Zero(), foreseen = Vector6::Zero(), before = Vector6::Zero();
        c->grasp.col(k) = -grasp_gain * (e - c->common);
        if (asked) {
            shift = c->asked_shift.col(k);
            e += shift;
            c->grasp.col(k) -= grasp_gain * (shift - common_shift);
        }
        if (predicted) foreseen = (c->predicted.col(k) - e + bend) * per_step, before = c->foreseen.col(k);
        c->foresees.col(k) = foreseen;
        c->offsets.col(k) = asked ? Vector6(foreseen + shift / h) : foreseen;
        if (predicted) c->left_over.col(k) = c->offsets.col(k) - before;
        else c->left_over.col(k).setZero();
    }
    c->path = -path_gain * (c->proposal->has_measured ? c->measured : c->common);
    c->proposal->closed_share = h * grasp_gain / bound(c, c->grasp, c->arms);
    bound(c, c->path, 1);
}

/* -- linear algebra: one small system, two right-hand sides ---------------------------------------------------------- */

/* Two numbers side by side, as GCC and Clang know them; other compilers leave it to the plain step. */
typedef double pair __attribute__((vector_size(16)));
/* Rows of [A | b₀ b₁ …], with so many pairs of right-hand sides: entry (i, j) is rows[i][j / 2][j % 2]. */
template <int PAIRS = 1>
using Rows = pair[6][3 + PAIRS];
#define UNROLL _Pragma("GCC unroll 6")

/* The answers of an eliminated system, whose pivots' inverses are given, in the right-hand sides' place. */
template <int PAIRS>
static inline void substitute_back(pair (&A)[6][3 + PAIRS], const double (&inverse)[6]) {
    for (int b = 3; b < 3 + PAIRS; b++)
        UNROLL for (int k = 5; k >= 0; k--) {
            pair x = A[k][b];
            UNROLL for (int j = k + 1; j < 6; j++) {
                double f = A[k][j / 2][j % 2];
                x -= pair{f, f} * A[j][b];
            }
            A[k][b] = x * pair{inverse[k], inverse[k]};
        }
}

/* Solve by elimination with partial pivoting; the answers take the right-hand sides' place. Returns the smallest pivot, 0 if
 * the matrix is singular. */
template <int PAIRS>
static double solve6(pair (&A)[6][3 + PAIRS]) {
    double scale = 0.0, least = INFINITY, inverse[6];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            double size = fabs(A[i][j / 2][j % 2]);
            scale = size > scale ? size : scale;
        }
    UNROLL for (int k = 0; k < 6; k++) {
        int first = k / 2, pivot = k;
        double largest = fabs(A[k][first][k % 2]);
        UNROLL for (int i = k + 1; i < 6; i++) {
            double size = fabs(A[i][first][k % 2]);
            pivot = size > largest ? i : pivot;
            largest = size > largest ? size : largest;
        }
        if (!(largest > SMALLEST_PIVOT * scale)) return 0.0;
        least = largest < least ? largest : least;
        if (pivot != k)
            for (int j = first; j < 3 + PAIRS; j++) {
                pair other = A[pivot][j];
                A[pivot][j] = A[k][j];
                A[k][j] = other;
            }
        inverse[k] = 1.0 / A[k][first][k % 2];
        UNROLL for (int i = k + 1; i < 6; i++) {
            double f = A[i][first][k % 2] * inverse[k];
            for (int j = first; j < 3 + PAIRS; j++) A[i][j] -= pair{f, f} * A[k][j];
        }
    }
    substitute_back<PAIRS>(A, inverse);
    return least;
}

/* The upper half of J S² Jᵀ of n joints, S = diag(scale). */
template <int PAIRS>
static void gram6(const double *jacobian, const double *scale, int n, pair (&A)[6][3 + PAIRS]) {
    pair G[6][3] = {};
    for (int j = 0; j < n; j++) {
        pair column[3];
        memcpy(column, jacobian + 6 * j, sizeof column);
        const double square = scale[j] * scale[j];
        UNROLL for (int i = 0; i < 6; i++) {
            const double own = square * column[i / 2][i % 2];
            UNROLL for (int k = i / 2; k < 3; k++) G[i][k] += pair{own, own} * column[k];
        }
    }
    for (int i = 0; i < 6; i++)
        for (int k = i / 2; k < 3; k++) A[i][k] = G[i][k];
}

/* Solve as solve6 does, for a symmetric, positive semidefinite matrix of which the upper half is given: no pivoting. */
template <int PAIRS>
static inline double solve_gram6(pair (&A)[6][3 + PAIRS]) {
    double scale = 0.0, least = INFINITY, inverse[6];
    for (int i = 0; i < 6; i++) scale = A[i][i / 2][i % 2] > scale ? A[i][i / 2][i % 2] : scale;
    UNROLL for (int k = 0; k < 6; k++) {
        const double pivot = A[k][k / 2][k % 2];
        if (!(pivot > SMALLEST_PIVOT * scale)) return 0.0;
        least = pivot < least ? pivot : least;
        inverse[k] = 1.0 / pivot;
        UNROLL for (int i = k + 1; i < 6; i++) {
            const double f = A[k][i / 2][i % 2] * inverse[k];
            for (int j = i / 2; j < 3 + PAIRS; j++) A[i][j] -= pair{f, f} * A[k][j];
        }
    }
    substitute_back<PAIRS>(A, inverse);
    return least;
}

/* Numbers of one arm's joints, and columns of them; they need no heap. */
using ArmVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, MOST_JOINTS, 1>;
using ArmColumns = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, MOST_JOINTS>;
using ArmRows6 = Eigen::Matrix<double, Eigen::Dynamic, 6, 0, MOST_JOINTS, 6>;
using ArmSquare = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, MOST_JOINTS, MOST_JOINTS>;
using OfArm = Eigen::Map<const Matrix6X>;

/* Jacobi's rotations: a symmetric matrix becomes diagonal, its eigenvectors are the rows of V. */
template <typename Symmetric>
static void by_rotations(Symmetric &G, Symmetric &V) {
    const int size = Symmetric::RowsAtCompileTime < 0 ? (int)G.rows() : Symmetric::RowsAtCompileTime;
    const double trace = G.trace();
    V = Symmetric::Identity(size, size);
    for (int sweep = 0; sweep < MOST_SWEEPS; sweep++) {
        double off = 0.0;
        for (int a = 0; a < size - 1; a++)
            for (int b = a + 1; b < size; b++) {
                const double g = G(a, b);
                off = max_of(off, fabs(g));
                if (!(fabs(g) > SMALL_ROTATION * trace)) continue;
                const double half = 0.5 * (G(b, b) - G(a, a)) / g;
                const double t = copysign(1.0, half) / (fabs(half) + sqrt(half * half + 1.0));
                const double co = 1.0 / sqrt(t * t + 1.0), s = t * co;
                const Eigen::JacobiRotation<double> rotation(co, s);
                G.applyOnTheRight(a, b, rotation);
                G.applyOnTheLeft(a, b, rotation.transpose());
                V.applyOnTheLeft(a, b, rotation.transpose());
            }
        if (!(off > SMALL_ROTATION * trace)) break;
    }
}

/* Least eigenvalue of a symmetric matrix, and its eigenvector. */
template <typename Symmetric, typename Column>
static double least_by_rotations(Symmetric G, Column *u) {
    Symmetric V;
    int least;
    by_rotations(G, V);
    const double found = G.diagonal().minCoeff(&least);
    *u = V.row(least).transpose();
    return max_of(found, 0.0);
}

/* The (pseudo-)inverse P (n, m) of J (m, n) of least Σ (v/scale)², in which small singular values count as the floor. */
template <typename Square, typename Columns, typename Units, typename TallRows>
static void floored_inverse(const Columns &J, const Units &W, TallRows &P) {
    const Columns A = J * W.asDiagonal();
    const bool tall = A.rows() > A.cols(); /* A⁺ = V S⁻¹ Uᵀ = V S⁻² Vᵀ Aᵀ = Aᵀ U S⁻² Uᵀ, by the smaller square */
    const Eigen::Index n = tall ? A.cols() : A.rows();
    Square G = Square::Zero(n, n), V;
    if (tall) G = A.transpose().lazyProduct(A);
    else G = A.lazyProduct(A.transpose());
    by_rotations(G, V);
    for (Eigen::Index i = 0; i < n; i++) {
        const double s = max_of(sqrt(max_of(G(i, i), 0.0)), SINGULAR_FLOOR * SINGULAR_FLOOR);
        V.row(i) /= sqrt(s * max_of(s, SINGULAR_FLOOR));
    }
    const Square inverse = V.transpose().lazyProduct(V);
    P = A.transpose();
    if (tall) P = TallRows(inverse.lazyProduct(P));
    else P = TallRows(P.lazyProduct(inverse));
    P = W.asDiagonal() * P;
}

using OfJoints = Eigen::Map<Eigen::VectorXd>;

/* Of one arm with n joints: velocities v0, v1 for the world twists w0, w1, near the null-space references u0, u1 of a redundant
 * arm: v = u + A⁺(w − J u), A⁺ the right inverse of least Σ (v/scale)². Fewer than six joints make the closest twists that they
 * can. Returns the smallest pivot of A, or, of a redundant arm, the root of the smallest pivot of A Aᵀ; 0 if it is singular. */
static double arm_velocities(const double *jacobian, const double *scale, int n, const Vector6 &w0, const Vector6 &w1,
                             const double *u0, const double *u1, double *v0, double *v1) {
    const OfArm J(jacobian, 6, n);
    Rows<> A;
    double least;
    if (n < 6) {
        ArmRows6 P;
        floored_inverse<ArmSquare>(ArmColumns(J), Given(scale, n), P);
        OfJoints(v0, n) = P.lazyProduct(w0), OfJoints(v1, n) = P.lazyProduct(w1);
        return INFINITY;
    }
    if (n == 6) {
        for (int i = 0; i < 6; i++) {
            for (int j = 0; j < 3; j++) A[i][j] = pair{J(i, 2 * j), J(i, 2 * j + 1)};
            A[i][3] = pair{w0[i], w1[i]};
        }
        if (!((least = solve6<1>(A)) > 0.0)) return 0.0;
        for (int j = 0; j < 6; j++) v0[j] = A[j][3][0], v1[j] = A[j][3][1];
        return least;
    }
    pair missing[6]; /* w − J u */
    UNROLL for (int i = 0; i < 6; i++) missing[i] = pair{w0[i], w1[i]};
    for (int j = 0; j < n; j++)
        UNROLL for (int i = 0; i < 6; i++) missing[i] -= J(i, j) * pair{u0[j], u1[j]};
    UNROLL for (int i = 0; i < 6; i++) A[i][3] = missing[i];
    gram6<1>(jacobian, scale, n, A);
    if (!((least = solve_gram6<1>(A)) > 0.0)) return 0.0;
    for (int j = 0; j < n; j++) {
        pair along = {0.0, 0.0};
        UNROLL for (int i = 0; i < 6; i++) along += J(i, j) * A[i][3];
        along = pair{u0[j], u1[j]} + scale[j] * scale[j] * along;
        v0[j] = along[0], v1[j] = along[1];
    }
    return sqrt(least);
}

/* The columns of J of the joints that move the tool of arm k, from the base on. */
static ArmColumns columns_of_arm(const Core *c, int k, const double *jacobian) {
    const int n = joints_behind(c, k);
    ArmColumns J(6, n);
    for (int j = 0; j < n; j++) J.col(j) = Eigen::Map<const Vector6>(jacobian + 6 * joint_behind(c, k, j));
    return J;
}

/* From the Jacobian's point to the point nearest to the axes of the arm's turning joints: (Σ 1 − a aᵀ) way = Σ a × v.
 * Returns whether it is far. */
static bool far_from_axes(const OfArm &J, Vector3 *way) {
    Matrix3 S = Matrix3::Zero(), adjugate;
    Vector3 feet = Vector3::Zero();
    for (int j = 0; j < J.cols(); j++) {
        const Vector3 v = J.col(j).head<3>(), a = J.col(j).tail<3>();
        if (a.squaredNorm() < 0.5) continue; /* it slides */
        feet += a.cross(v);
        S += Matrix3::Identity() - a * a.transpose();
    }
    for (int i = 0; i < 3; i++) adjugate.row(i) = S.row((i + 1) % 3).cross(S.row((i + 2) % 3)); /* S is symmetric */
    const double det = S.row(0).dot(adjugate.row(0));
    if (!(det > 1e-9)) return false;
    *way = adjugate * feet / det;
    return way->squaredNorm() > LONG_LEVER * LONG_LEVER;
}

/* A twist at another point. */
static Vector6 twist_at(const Vector6 &w, const Vector3 &way) {
    Vector6 out = w;
    out.head<3>() += w.tail<3>().cross(way);
    return out;
}

/* The same where the Jacobian's point is far from the arm: about a point of the arm, so that its lever does not count as
 * a singularity. 0 where it is near. */
static double far_velocities(const double *jacobian, const double *scale, int n, const Vector6 &w0, const Vector6 &w1,
                             const double *u0, const double *u1, double *v0, double *v1) {
    const OfArm J(jacobian, 6, n);
    Vector3 way;
    ArmColumns near(6, n);
    if (!far_from_axes(J, &way)) return 0.0;
    for (int j = 0; j < n; j++) near.col(j) = twist_at(J.col(j), way);
    return arm_velocities(near.data(), scale, n, twist_at(w0, way), twist_at(w1, way), u0, u1, v0, v1);
}

static inline double near_or_far(const double *J, const double *scale, int n, const Vector6 &w0, const Vector6 &w1,
                                 const double *u0, const double *u1, double *v0, double *v1) {
    const double least = arm_velocities(J, scale, n, w0, w1, u0, u1, v0, v1);
    return least > 0.0 ? least : far_velocities(J, scale, n, w0, w1, u0, u1, v0, v1);
}

static const double no_reference[MOST_JOINTS] = {};

/* The same of an arm whose own joints are not in line; null-space references and velocities are of all joints. */
static double gathered_velocities(const Core *c, const ArmJoints &a, const double *jacobian, const Vector6 &w0,
                                  const Vector6 &w1, const double *u0, const double *u1, double *v0, double *v1) {
    double columns[6 * MOST_JOINTS], units[MOST_JOINTS], references[2][MOST_JOINTS], found[2][MOST_JOINTS];
    const double *J = side_by_side(a, jacobian, 6, columns), *scale = side_by_side(a, c->scale, 1, units);
    const double *reference0 = u0 ? side_by_side(a, u0, 1, references[0]) : no_reference;
    const double *reference1 = u1 ? side_by_side(a, u1, 1, references[1]) : no_reference;
    const double least = near_or_far(J, scale, a.n, w0, w1, reference0, reference1, found[0], found[1]);
    spread(a, found[0], v0), spread(a, found[1], v1);
    return least;
}

static int two_velocities(Core *c, const double *jacobian, const Twists &w0, const Vector6 &w1, const double *u0,
                          const double *u1, double *v0, double *v1, const double *own1) {
    for (int k = 0; k < c->arms; k++) {
        if (group_of(c, k)) continue;
        const ArmJoints &a = joints_of(c, k);
        if (follows_way(c, k)) { /* it moves no object: its null-space references are its motion */
            for (int i = 0; i < a.n; i++) v0[a.own(i)] = u0 ? u0[a.own(i)] : 0.0, v1[a.own(i)] = u1 ? u1[a.own(i)] : 0.0;
            c->least_pivot[k] = INFINITY;
            continue;
        }
        const Vector6 own = w0.col(k), second = own1 ? Vector6(Eigen::Map<const Vector6>(own1 + 6 * k)) : w1;
        const int j = a.start;
        const double least = a.in_line ? near_or_far(jacobian + 6 * j, c->scale + j, a.n, own, second, u0 ? u0 + j : no_reference,
                                                     u1 ? u1 + j : no_reference, v0 + j, v1 + j)
                                       : gathered_velocities(c, a, jacobian, own, second, u0, u1, v0, v1);
        if (!(least > 0.0)) return 0;
        c->least_pivot[k] = least;
    }
    for (int i = 0; i < c->groups; i++)
        if (!group_velocities(c, c->group[i], jacobian, w0, own1 ? own1 : w1.data(), own1, u0, u1, v0, v1)) return 0;
    return 1;
}

/* v = u + A⁺(σ ν + c_p + c_k + b_k − J u): the command at full corrections and rate `cap`, and what a unit of rate adds. */
static int nominal_command(Core *c, double cap) {
    Twists w(c->scratch, 6, c->arms);
    const double *u0 = nullptr, *u1 = nullptr;
    const Matrix3 &R = c->pose->R;
    const Vector6 common = cap * c->along + c->path;
    const bool moving = grasps_move(c);
    for (int k = 0; k < c->arms; k++) {
        const Vector6 own = moving ? Vector6(cap * c->own_along.col(k) + c->path) : common;
        w.col(k) = turned(R, own + c->grasp.col(k) + c->offsets.col(k));
        if (moving) c->own_world.col(k) = turned(R, c->own_along.col(k));
    }
    if (c->redundant || any_follows_way(c)) {
        Vector reference(c->scratch + 6 * c->arms, c->joints, 1);
        reference = cap * c->null_along + c->null_offset;
        u0 = reference, u1 = c->null_along;
    }
    return two_velocities(c, c->jacobian, w, turned(R, c->along), u0, u1, c->command, c->along_velocity,
                          moving ? (double *)c->own_world : nullptr);
}

/* -- null-space references of redundant arms ---------------------------------------------------------------------------------------- */

/* √det(J Jᵀ) of one arm */
static double manipulability(const Core *c, int k, const double *positions, double *jacobian) {
    const ArmJoints &a = joints_of(c, k);
    const Vector3 about = Vector3::Zero();
    double columns[6 * MOST_JOINTS];
    follow_arm<true>(c, k, positions, &about, nullptr, jacobian);
    const OfArm J(side_by_side(a, jacobian, 6, columns), 6, a.n);
    Matrix6 G = J.lazyProduct(J.transpose());
    double det = 1.0;
    for (int i = 0; i < 6; i++) { /* Gᴸᵀ: no pivots, for it is positive semidefinite */
        det *= G(i, i);
        if (!(G(i, i) > 0.0)) return 0.0;
        for (int m = i + 1; m < 6; m++) G.row(m) -= G(m, i) / G(i, i) * G.row(i);
    }
    return sqrt(det);
}

static double wrapped(const Core *c, int j, double angle) {
    return c->continuous[j] != 0.0 ? remainder(angle, 2.0 * 3.14159265358979323846) : angle;
}

static void posture_velocity(Core *c, const double *positions, double *v) {
    const Options *o = c->options;
    const double step = 1e-5;
    double excess = 1.0;
    Vector velocity(v, c->joints, 1), moved(c->posture_work, c->joints, 1);
    velocity.setZero();
    const auto to_target = [&](int j) {
        const double way = o->posture_gain * wrapped(c, j, c->posture_target[j] - positions[j]);
        return c->posture_bounded[j] != 0.0 ? way + o->centring * (c->posture_middle[j] - positions[j]) : way;
    };
    for (int i = 0; i < c->groups; i++)
        for (int m = 0; m < c->group[i].shared; m++) {
            const int j = c->group[i].joint[m];
            v[j] = to_target(j);
            excess = max_of(excess, fabs(v[j]) / c->posture_cap[j]);
        }
    for (int k = 0; k < c->arms; k++) {
        const ArmJoints &a = joints_of(c, k);
        const bool redundant = a.n > 6 || group_of(c, k);
        for (int i = 0; i < a.n && redundant; i++) {
            const int j = a.own(i);
            v[j] = to_target(j);
            if (o->manipulability > 0.0 && a.n > 6) {
                double *jacobian = c->posture_work + c->joints;
                moved = Given(positions, c->joints);
                moved[j] += step;
                const double up = manipulability(c, k, moved, jacobian);
                moved[j] = positions[j] - step;
                v[j] += o->manipulability * (up - manipulability(c, k, moved, jacobian)) / (2.0 * step);
            }
            excess = max_of(excess, fabs(v[j]) / c->posture_cap[j]);
        }
    }
    if (excess > 1.0) velocity /= excess;
}
