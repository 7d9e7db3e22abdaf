/* Kinematics of one arm at one configuration: its tool's pose and Jacobian, Newton's method, derivatives along a way.
 *
 * An arm is 14 numbers per joint and 12 for its tool: rotation (9, row major) and origin (3) of the joint in the frame of
 * the one before, both with the z axis along the joint's axis; 1 if it slides; its weight. The tool is R (9), p (3) in
 * the last joint. Jacobians (6, joints) are [linear; angular] of the tool's point in world axes. */

#ifndef COOPQP_ARM_H
#define COOPQP_ARM_H

#include <string.h>

#include <Eigen/QR>
#include <utility>

#include "frames.h"
#include "constants.h"

#define PER_JOINT 14
#define SLIDES 12
#define WEIGHT 13
#define LEAST_DAMPING 1e-15
#ifdef __GNUC__
#define UNROLL _Pragma("GCC unroll 6")
#else
#define UNROLL
#endif

/* Numbers of the joints of an arm, and columns of them, which need no heap. */
using ArmColumns = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, MOST_JOINTS>;
using OfJoints = Eigen::Map<Eigen::VectorXd>;

struct Arm {
    int joints;
    const double *numbers, *tool;

    bool slides(int j) const { return numbers[PER_JOINT * j + SLIDES] != 0.0; }
    /* W², by which joint j's motion counts. */
    double weight(int j) const { return numbers[PER_JOINT * j + WEIGHT] * numbers[PER_JOINT * j + WEIGHT]; }
};

/* -- one configuration ----------------------------------------------------------------------------------------------- */

static Pose place(const Arm &a, const double *q, double *jacobian) {
    Frame f;
    Vector3 axes[MOST_JOINTS], origins[MOST_JOINTS];
    for (int j = 0; j < a.joints; j++) {
        const double *joint = a.numbers + PER_JOINT * j;
        advance(f, joint, joint + 9, a.slides(j), q[j], sin(q[j]), cos(q[j]));
        axes[j] = f.axis(), origins[j] = f.origin();
    }
    const Pose T = held_at(f, *reinterpret_cast<const Pose *>(a.tool));
    for (int j = 0; jacobian && j < a.joints; j++) twist_of(axes[j], origins[j], a.slides(j), T.p, jacobian + 6 * j);
    return T;
}

static Pose place(const Arm &a, const double *q, ArmColumns &J) {
    J.resize(6, a.joints);
    return place(a, q, J.data());
}

/* What leads from T to the target: displacement and rotation vector in world axes. Returns the largest entry. */
static double error_of(const Pose &T, const Pose &target, Vector6 &e) {
    e = both(target.p - T.p, rotation_vector(target.R * T.R.transpose()));
    return e.allFinite() ? e.cwiseAbs().maxCoeff() : INFINITY;
}

/* Factors L D Lᵀ of J W² Jᵀ + damping I, of joints of weights W². */
class Factors {
public:
    /* False if it is not positive definite. */
    bool of(const Arm &a, const ArmColumns &J, double damping) {
        G.setZero();
        for (int j = 0; j < a.joints; j++) G += a.weight(j) * J.col(j) * J.col(j).transpose();
        G.diagonal().array() += damping + LEAST_DAMPING * G.trace();
        UNROLL for (int k = 0; k < 6; k++) { /* Lᵀ above the diagonal, D⁻¹ on it; no square root: each step waits for the last */
            if (!(G(k, k) > 0.0)) return false;
            G(k, k) = 1.0 / G(k, k);
            UNROLL for (int i = k + 1; i < 6; i++) {
                const double below = G(k, i) * G(k, k);
                UNROLL for (int m = i; m < 6; m++) G(i, m) -= below * G(k, m);
                G(k, i) = below;
            }
        }
        return true;
    }
    Vector6 solve(Vector6 y) const {
        UNROLL for (int k = 0; k < 6; k++)
            UNROLL for (int i = 0; i < k; i++) y[k] -= G(i, k) * y[i];
        UNROLL for (int i = 5; i >= 0; i--) {
            y[i] *= G(i, i);
            UNROLL for (int k = i + 1; k < 6; k++) y[i] -= G(i, k) * y[k];
        }
        return y;
    }

private:
    Matrix6 G;
};

/* v = W² Jᵀ (J W² Jᵀ + damping I)⁻¹ e; returns the largest step, infinite on failure. */
static double newton_step(const Arm &a, const ArmColumns &J, const Vector6 &e, double damping, double *v) {
    Factors G;
    double largest = 0.0;
    if (!G.of(a, J, damping)) return INFINITY;
    const Vector6 y = G.solve(e);
    for (int j = 0; j < a.joints; j++) {
        v[j] = a.weight(j) * J.col(j).dot(y);
        largest = maximum(largest, fabs(v[j]));
    }
    return isfinite(largest) ? largest : INFINITY;
}

/* Newton's method from q; returns the residual. */
static double solve(const Arm &a, const Pose &target, double *q, double tolerance, int steps, double longest, double damping) {
    ArmColumns J;
    Vector6 e;
    double v[MOST_JOINTS];
    for (int i = 0;; i++) {
        const double residual = error_of(place(a, q, J), target, e);
        if (residual <= tolerance || i >= steps || residual == INFINITY) return residual;
        const double largest = newton_step(a, J, e, damping * e.squaredNorm(), v);
        if (largest == INFINITY) return residual;
        const double share = largest > longest ? longest / largest : 1.0;
        for (int j = 0; j < a.joints; j++) q[j] += share * v[j];
    }
}

/* -- along a way ----------------------------------------------------------------------------------------------------- */

/* J′ = Σ_i q′_i ∂_i J: Lie brackets of the columns, their sums over i as running sums. */
static ArmColumns jacobian_slopes(const ArmColumns &J, const double *slope) {
    ArmColumns out(6, J.cols());
    Vector3 turned = Vector3::Zero(), beyond = Vector3::Zero();
    for (int j = 0; j < J.cols(); j++) { /* by the joints up to j */
        const Vector3 linear = J.col(j).head<3>(), angular = J.col(j).tail<3>();
        turned += slope[j] * angular;
        out.col(j) = both(turned.cross(linear), turned.cross(angular));
    }
    for (int j = (int)J.cols() - 1; j >= 0; j--) { /* by the joints after j */
        const Vector3 linear = J.col(j).head<3>(), angular = J.col(j).tail<3>();
        out.col(j).head<3>() += angular.cross(beyond);
        beyond += slope[j] * linear;
    }
    return out;
}

/* Triangular factors of Jᵀ (6, 6), its rows in an order of largest pivots. */
class Elimination {
public:
    explicit Elimination(const ArmColumns &J) : A(J.transpose()) {
        for (int k = 0; k < 6; k++) order[k] = k;
        for (int k = 0; k < 6; k++) {
            int pivot = k;
            for (int i = k + 1; i < 6; i++)
                if (fabs(A(i, k)) > fabs(A(pivot, k))) pivot = i;
            if (pivot != k) A.row(k).swap(A.row(pivot)), std::swap(order[k], order[pivot]);
            negative ^= (pivot != k) ^ (A(k, k) < 0.0);
            for (int i = k + 1; i < 6; i++) {
                const double f = A(i, k) /= A(k, k);
                for (int j = k + 1; j < 6; j++) A(i, j) -= f * A(k, j);
            }
        }
    }
    /* x with J x = V */
    void solve(const Vector6 &V, double *x) const {
        Vector6 y = V;
        for (int k = 0; k < 6; k++) {
            for (int i = 0; i < k; i++) y[k] -= A(i, k) * y[i];
            y[k] /= A(k, k);
        }
        for (int k = 5; k >= 0; k--) {
            for (int i = k + 1; i < 6; i++) y[k] -= A(i, k) * y[i];
            x[order[k]] = y[k];
        }
    }
    /* Whether det J is negative. */
    bool negative = false;

private:
    Matrix6 A;
    int order[6];
};

/* x of least norm that brings J x closest to V, of an arm with fewer than six joints. */
class LeastSquares {
public:
    explicit LeastSquares(const ArmColumns &J) : factors(Few(J)) {}
    void solve(const Vector6 &V, double *x) const { OfJoints(x, factors.cols()) = factors.solve(V); }

private:
    using Few = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, 5>;
    const Eigen::CompleteOrthogonalDecomposition<Few> factors;
};

/* q′ = J⁺ V and q″ = J⁺ (V′ − J′ q′), given J⁺. */
template <class Inverse>
static void follow(const Inverse &inverse, const ArmColumns &J, const Vector6 &V, const Vector6 &dV, double *slope,
                   double *curvature) {
    inverse.solve(V, slope);
    const ArmColumns slopes = jacobian_slopes(J, slope);
    Vector6 rest = dV;
    for (int j = 0; j < J.cols(); j++) rest -= slope[j] * slopes.col(j);
    inverse.solve(rest, curvature);
}

/* Derivatives q′ and q″ of the joints, for the tool's twist V per unit of s and its slope V′. The tool follows
 * J(q) q′ = V(s), so q′ = J⁺ V and q″ = J⁺ (V′ − J′ q′) with J⁺ = J⁻¹ of six joints, of fewer least squares. Of more
 * q′ = W² Jᵀ y with J W² Jᵀ y = V and the weights W, so q″ = W² (J′ᵀ y + Jᵀ y′) with
 * J W² Jᵀ y′ = V′ − J′ q′ − J W² J′ᵀ y. */
static void derivatives(const Arm &a, const double *q, const Vector6 &V, const Vector6 &dV, double *slope, double *curvature) {
    ArmColumns J;
    Vector6 rest = dV;
    place(a, q, J);
    if (a.joints < 6) return follow(LeastSquares(J), J, V, dV, slope, curvature);
    if (a.joints == 6) return follow(Elimination(J), J, V, dV, slope, curvature);
    Factors G;
    double turn[MOST_JOINTS];
    if (!G.of(a, J, 0.0)) {
        OfJoints(slope, a.joints).setConstant(NAN), OfJoints(curvature, a.joints).setConstant(NAN);
        return;
    }
    const Vector6 y = G.solve(V);
    for (int j = 0; j < a.joints; j++) slope[j] = a.weight(j) * J.col(j).dot(y);
    const ArmColumns slopes = jacobian_slopes(J, slope);
    for (int j = 0; j < a.joints; j++) {
        turn[j] = a.weight(j) * slopes.col(j).dot(y);
        rest -= slope[j] * slopes.col(j) + turn[j] * J.col(j);
    }
    const Vector6 dy = G.solve(rest);
    for (int j = 0; j < a.joints; j++) curvature[j] = turn[j] + a.weight(j) * J.col(j).dot(dy);
}

/* -- along poses ----------------------------------------------------------------------------------------------------- */

/* Whether det J of an arm of six joints is negative; false for other arms. */
static bool mirrored(const Arm &a, const double *q) {
    ArmColumns J;
    if (a.joints != 6) return false;
    place(a, q, J);
    return Elimination(J).negative;
}

/* Halfway between two poses: along the line, about one axis. */
static Pose halfway(const Pose &from, const Pose &to) {
    return {exp3(0.5 * rotation_vector(to.R * from.R.transpose())) * from.R, 0.5 * (from.p + to.p)};
}

/* From q at one pose to the next without a jump and without passing a singularity; halves the way where it has to. */
static bool step_to(const Arm &a, const Pose &from, const Pose &to, double *q, double tolerance, double longest, int halvings) {
    double next[MOST_JOINTS], furthest = 0.0;
    memcpy(next, q, sizeof(double) * (size_t)a.joints);
    const double residual = solve(a, to, next, tolerance, 12, longest, 0.0);
    for (int j = 0; j < a.joints; j++) furthest = maximum(furthest, fabs(next[j] - q[j]));
    if (residual <= tolerance && furthest <= longest && mirrored(a, next) == mirrored(a, q)) {
        memcpy(q, next, sizeof(double) * (size_t)a.joints);
        return true;
    }
    if (halvings <= 0) return false;
    const Pose between = halfway(from, to);
    return step_to(a, from, between, q, tolerance, longest, halvings - 1) &&
           step_to(a, between, to, q, tolerance, longest, halvings - 1);
}

/* From the first of q (poses, joints) along the poses as far as it goes; the rest stays there. The last pose reached. */
static Eigen::Index walk(const Arm &a, const Pose *path, Eigen::Index poses, double *q, double tolerance, double longest,
                         int halvings) {
    Eigen::Map<Eigen::MatrixXd> way(q, a.joints, poses);
    Eigen::Index k = 1;
    for (; k < poses; k++) {
        way.col(k) = way.col(k - 1);
        if (!step_to(a, path[k - 1], path[k], way.col(k).data(), tolerance, longest, halvings)) break;
    }
    for (Eigen::Index rest = k; rest < poses; rest++) way.col(rest) = way.col(rest - 1);
    return k - 1;
}

#endif
