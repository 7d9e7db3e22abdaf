/* Arms with fewer than six joints: what the object can do with them, and what they can follow of it.
 *
 * With P_k the projector on the twists that arm k can make and F = Σ (1 − P_k), the arms follow the same twists z with
 * F z = 0. Their own twists c_k are moved by the common one w = −F⁺ Σ (1 − P_k) c_k, which brings all c_k + w closest to what
 * they can follow; each projected alone, twists that all have in common would lead the arms apart. See docs/derivations.md. */

#include "functions.h"

/* Common twists that few joints lack by less than this share, squared, close no chain: they would be large */
constexpr double CLOSING = 1e-3;
constexpr double ADMITTED = 1e-8; /* twists that few joints lack by less than this, squared, they follow */
constexpr double FEW_FOLLOW = 1e-4; /* few joints follow a path if Newton's method leaves no larger error [m, rad] */

static bool has_few(const Core *c, int k) { return joints_behind(c, k) < 6 && !follows_way(c, k); }

/* Whether some arm that moves the object has few joints. */
static bool some_have_few(const Core *c) {
    for (int k = 0; c->few && k < c->arms; k++)
        if (has_few(c, k)) return true;
    return false;
}

/* Orthonormal twists that arm k can make, in the reference frame; others are zero. */
static Matrix6 range_of(const Core *c, int k) {
    ArmColumns J = columns_of_arm(c, k, c->jacobian);
    Matrix6 U = Matrix6::Zero();
    for (int j = 0; j < J.cols(); j++) J.col(j) = turned_back(c->pose->R, J.col(j));
    ArmSquare G = J.transpose().lazyProduct(J), V;
    by_rotations(G, V);
    for (int i = 0; i < J.cols(); i++) {
        const double s = sqrt(max_of(G(i, i), 0.0));
        if (s > SINGULAR_FLOOR) U.col(i) = J.lazyProduct(V.row(i).transpose()) / s;
    }
    return U;
}

/* The same, as it is kept. */
static Square range_at(const Core *c, int k) { return {c->ranges + 36 * k, 6, 6}; }

/* What arm k cannot follow of a twist. */
static Vector6 beyond(const Core *c, int k, const Vector6 &twist) {
    const Square U = range_at(c, k);
    const Vector6 along = U.transpose().lazyProduct(twist);
    return twist - U.lazyProduct(along);
}

/* Move twists of all arms by one common twist, then leave of each what its arm can follow. */
static void bring_closest(const Core *c, const Matrix6 &inverse, Twists &twists) {
    Vector6 lost = Vector6::Zero();
    for (int k = 0; k < c->arms; k++)
        if (has_few(c, k)) lost += beyond(c, k, twists.col(k));
    const Vector6 common = inverse.lazyProduct(lost);
    twists.colwise() -= common;
    for (int k = 0; k < c->arms; k++)
        if (has_few(c, k)) twists.col(k) -= beyond(c, k, twists.col(k));
}

/* Twists of the object that all arms can follow, in the reference frame, orthonormal in the units of the off-path twist; others
 * are zero. */
static void admit(Core *c, const Matrix6 &F, const Matrix6 &V) {
    int found = 0;
    c->admitted.setZero();
    for (int i = 0; i < 6; i++) {
        if (!(F(i, i) < ADMITTED)) continue;
        Vector6 y = V.row(i).transpose().cwiseQuotient(Given(c->unit, 6));
        for (int twice = 0; twice < 2; twice++)
            for (int m = 0; m < found; m++) y -= c->admitted.col(m).dot(y) * c->admitted.col(m);
        c->admitted.col(found++) = y.normalized();
    }
}

/* One of them. */
static Vector6 admitted_twist(const Core *c, int i) { return c->admitted.col(i).cwiseProduct(Given(c->unit, 6)); }

/* The part of a twist of the object that all arms can follow, closest in those units. */
static Vector6 admissible_part(const Core *c, const Vector6 &twist) {
    const Given unit(c->unit, 6);
    const Vector6 along = c->admitted.transpose().lazyProduct(Vector6(twist.cwiseQuotient(unit)));
    return unit.cwiseProduct(Vector6(c->admitted.lazyProduct(along)));
}

/* Remember the wanted motion, of which the arms may follow only a part. */
static void keep_whole(Core *c) {
    c->whole_along = c->along, c->whole_path = c->path;
    c->whole_own = c->own_along, c->whole_grasp = c->grasp, c->whole_offsets = c->offsets;
}

/* Leave of the wanted motion what the arms can follow as they are linearised now, and of the defects that they make up for. */
static void follow_part(Core *c) {
    Matrix6 F = Matrix6::Zero(), V, inverse = Matrix6::Zero();
    for (int k = 0; k < c->arms; k++) {
        if (!has_few(c, k)) continue;
        const Matrix6 U = range_of(c, k);
        range_at(c, k) = U;
        F += Matrix6::Identity() - U.lazyProduct(U.transpose());
    }
    by_rotations(F, V);
    const double least = CLOSING * F.diagonal().maxCoeff();
    for (int i = 0; i < 6; i++)
        if (F(i, i) > least) inverse += V.row(i).transpose() * V.row(i) / F(i, i);
    admit(c, F, V);
    c->along = admissible_part(c, c->whole_along), c->path = admissible_part(c, c->whole_path);
    c->own_along = c->whole_own, c->grasp = c->whole_grasp, c->offsets = c->whole_offsets;
    if (grasps_move(c)) bring_closest(c, inverse, c->own_along);
    bring_closest(c, inverse, c->grasp);
    bring_closest(c, inverse, c->offsets);
    bring_closest(c, inverse, c->foresees);
    c->proposal->closed_share = 0.0;
}

/* Whether the errors of the latest Newton step are too large for arms with few joints: they cannot follow the path. */
static bool cannot_follow(const Core *c, const Twists &errors) {
    for (int k = 0; c->few && k < c->arms; k++)
        if (has_few(c, k) && !(errors.col(k).cwiseAbs().maxCoeff() < FEW_FOLLOW)) return true;
    return false;
}
