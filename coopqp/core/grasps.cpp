/* How the tools move on the object along its path, and which arms hold it: coopqp/paths/grasp_motion.py defines it.
 *
 * The numbers: how many pieces each arm has (n); the number of contacts, each with the clock from which on it counts and
 * the arms' shares in the common error, and which arms hold (1 + 7 n); then the pieces, arm by arm: A (12), B (12), and the segment S (29) of
 * M = A S(τ) B, by which a tool has moved from its place in the object frame. */

#include "functions.h"

/* Numbers of a piece before its segment. */
#define BEFORE_SEGMENT 24

static bool grasps_move(const Core *c) { return c->grasp_numbers != nullptr; }

static const double *contacts_of(const Core *c) { return c->grasp_numbers + c->arms + 1; }

static int contact_count(const Core *c) { return (int)c->grasp_numbers[c->arms]; }

/* The first piece of an arm; its pieces follow it. */
static const double *pieces_of_arm(const Core *c, int k) {
    const double *piece = contacts_of(c) + (1 + 7 * c->arms) * contact_count(c);
    for (int i = 0; i < k; i++) piece += GRASP_PIECE * (int)c->grasp_numbers[i];
    return piece;
}

/* The last piece of an arm that has begun at a clock, or its first one; nullptr if it has none. */
static const double *piece_at(const Core *c, int k, double clock) {
    const int count = (int)c->grasp_numbers[k];
    const double *piece = pieces_of_arm(c, k);
    if (!count) return nullptr;
    int i = 0;
    for (int n = count; n > 1;) {
        const int half = n / 2;
        if (piece[GRASP_PIECE * (i + half) + BEFORE_SEGMENT + 18] <= clock) i += half, n -= half;
        else n = half;
    }
    return piece + GRASP_PIECE * i;
}

static Pose pose_at(const double *numbers) {
    return {Eigen::Map<const Matrix3>(numbers), Eigen::Map<const Vector3>(numbers + 9)};
}

static Pose inverse_of(const Pose &T) { return {T.R.transpose(), -(T.R.transpose() * T.p)}; }

/* M of a piece. */
static Pose moved_by(const double *piece, double clock) {
    const double *segment = piece + BEFORE_SEGMENT;
    return compose(compose(pose_at(piece), pose_on(segment, place_on(segment, clock))), pose_at(piece + 12));
}

/* The tools are where the path has them on the object at a clock, and have given way from there by a shift. */
static void place_grasps(Core *c, double clock, const Twists &shift) {
    const bool shifted = (shift.array() != 0.0).any();
    for (int k = 0; k < c->arms; k++) {
        const double *piece = piece_at(c, k, clock);
        c->object[k] = piece ? compose(c->places[k], inverse_of(moved_by(piece, clock))) : c->places[k];
        if (shifted) c->object[k] = compose(c->object[k], exp6(-shift.col(k)));
    }
    take_ways(c, clock);
}

static void take_contact(Core *c, double clock) {
    const double *row = contacts_of(c);
    const int size = 1 + 7 * c->arms;
    for (int i = 1; i < contact_count(c) && row[size] <= clock + 1e-12; i++) row += size;
    c->shares = Eigen::Map<const Matrix6X>(row + 1, 6, c->arms);
    c->holding = Given(row + 1 + 6 * c->arms, c->arms);
}

static bool contact_changes(const Core *c, double clock) {
    const double *row = contacts_of(c);
    const int size = 1 + 7 * c->arms;
    for (int i = 1; i < contact_count(c); i++)
        if (row[i * size] > c->changed_at[0] && row[i * size] <= clock + SAME_CLOCK) return true;
    return false;
}

/* M′ M⁻¹ = Ad(A S) t, with the body twist t of S. */
static Vector6 twist_on_object(const Core *c, int k, double clock) {
    const double *piece = piece_at(c, k, clock);
    if (!piece) return Vector6::Zero();
    const double *segment = piece + BEFORE_SEGMENT;
    const Place at = place_on(segment, clock);
    if (at.rate == 0.0) return Vector6::Zero();
    const Pose S = pose_on(segment, at), AS = compose(pose_at(piece), S);
    const Eigen::Map<const Vector3> turn(segment + 12), way(segment + 15);
    const Vector3 v = AS.R * (at.rate * (S.R.transpose() * way)), w = AS.R * (at.rate * turn);
    return both(v + AS.p.cross(w), w);
}

static int grasp_increments(Core *c, double clock, double span) {
    Pose later;
    c->own_along.setZero();
    if (!(span > 1e-12)) return 1;
    if (!path_pose(c, clock + span, later)) return 0;
    const Pose way = between(*c->pose, later);
    for (int k = 0; k < c->arms; k++) {
        const double *now = piece_at(c, k, clock), *then = piece_at(c, k, clock + span);
        if (!now) {
            c->own_along.col(k) = c->along;
            continue;
        }
        const Pose moved = compose(moved_by(then, clock + span), inverse_of(moved_by(now, clock)));
        if (!log6(compose(way, moved), c->own_along.col(k))) return 0;
        c->own_along.col(k) /= span;
    }
    return 1;
}
