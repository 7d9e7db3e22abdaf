/* How far the commands lead the arms apart.
 *
 * The arms' views O_k of the object should be one. Their errors without the mean are lengths at the grasps, turns
 * included, as in watch.cpp. Two parts of them were asked for, and do not count as long as they are corrected: the
 * mismatch of a start, and shifts of the grasps. Both are followed as a step corrects them: it makes up for what grasps
 * were shifted by since the step before, and takes a share of all other errors away. What is left is then compared with
 * the errors themselves: it is the share of it that they still show, and never grows. */

#include "functions.h"

constexpr double SAID_APART = 1e-5; /* arms commanded further apart are named [m] */
constexpr double TOGETHER_AGAIN = 0.5; /* share of the distance at which they were held from which on they go on */
constexpr double ALIKE = 1.0 + 1e-9; /* the first of arms equally far from the others is named */
constexpr double NO_MISMATCH = 1e-12; /* a smaller mismatch is none [m, rad] */

/* The errors of the arms without their mean. */
static void among_arms(const Twists &errors, Twists &out) {
    const Vector6 mean = mean_of(errors);
    for (int k = 0; k < errors.cols(); k++) out.col(k) = errors.col(k) - mean;
}

/* Take the mismatch that is still to be corrected away from `away`; keep the share of it that is left. */
static void without_mismatch(Core *c, Twists &away) {
    const double along = away.cwiseProduct(c->mismatch).sum(), square = c->mismatch.squaredNorm();
    const double left = square > 0.0 ? clamp(along / square, 0.0, 1.0) : 0.0;
    away -= left * c->mismatch;
    c->proposal->mismatch_left = left;
    c->proposal->mismatched = left * left * square > NO_MISMATCH * NO_MISMATCH;
}

/* The arm whose view of the object is furthest from another's; the first of those equally far. */
static int furthest_from(const Twists &away, int arm) {
    double most = -1.0;
    int other = 0;
    for (int k = 0; k < away.cols(); k++) {
        const double distance = (away.col(k) - away.col(arm)).norm();
        if (k != arm && !(distance <= most * ALIKE)) most = distance, other = k;
    }
    return other;
}

/* After the errors: `apart`, and a hold where it is too large. */
static void watch_chain(Core *c) {
    Proposal *p = c->proposal;
    const int n = c->arms;
    Twists away(c->scratch, 6, n);
    double most = 0.0;
    int arm = 0;
    if (n < 2) return;
    among_arms(c->errors, away);
    if (!c->loop->started) { /* whatever there is now is a mismatch of the start */
        c->mismatch = away;
        c->loop->has_mismatch = true;
    }
    if (c->loop->has_mismatch) without_mismatch(c, away);
    for (int k = 0; k < n; k++) { /* lengths at the grasps: displacement of their centre, and the turn about it */
        const Vector3 turn = away.col(k).tail<3>();
        away.col(k).head<3>() += c->at_grasps.block<3, 3>(3, 0).transpose() * turn;
        away.col(k).tail<3>() *= c->at_grasps(5, 5);
        const double square = away.col(k).squaredNorm();
        if (!(square <= most * (ALIKE * ALIKE))) most = square, arm = k;
    }
    p->apart = sqrt(most) * n / (n - 1.0);
    const double limit = c->options->apart_hold * (c->loop->chain_held ? TOGETHER_AGAIN : 1.0);
    p->chain_holds = !(p->apart <= limit);
    if (p->apart <= SAID_APART || (p->reason != NO_REASON && !(p->watch_cap > 0.0 && p->chain_holds))) return;
    const int other = furthest_from(away, arm), first = arm < other ? arm : other;
    if (p->chain_holds)
        refuse(c, CHAIN_PARTED, first, p->apart);
    else
        p->reason = CHAIN_APART, p->reason_index = first, p->reason_a = p->apart;
    p->reason_b = arm + other - first;
}

/* Once a step is made. */
static void chain_watched(Core *c) {
    const Proposal *p = c->proposal;
    if (!p->has_errors) return;
    c->loop->started = true, c->loop->chain_held = p->chain_holds;
    const int known = p->corrections_made && p->parting == 0.0 && !p->braked;
    const int left = c->loop->has_mismatch && p->mismatched;
    const bool asked = known && asked_to_shift(c);
    const double closes = known ? p->grasp_share * p->closed_share : 0.0;
    if (left || asked) {
        c->mismatch *= left ? p->mismatch_left : 0.0;
        if (asked) c->mismatch += c->asked_shift;
        c->mismatch *= 1.0 - closes;
    }
    c->loop->has_mismatch = left || asked, c->loop->has_asked_shift = false;
}

/* The grasps give way by other shifts: that parts the views of the object for a while, as it was asked for. */
static void expect_shift(Core *c, const Twists &shift) {
    Twists change(c->scratch, 6, c->arms);
    if (!memcmp(c->grasp_shift, shift, 6 * sizeof(double) * (size_t)c->arms)) return;
    change = c->grasp_shift - shift;
    c->grasp_shift = shift;
    if (!c->loop->has_mismatch) c->mismatch.setZero();
    if (!c->loop->has_asked_shift) c->asked_shift.setZero();
    among_arms(change, change);
    c->mismatch += change;
    c->asked_shift -= change;
    c->loop->has_mismatch = c->loop->has_asked_shift = true;
}

static int move_grasp(Core *c, const double *numbers) {
    const Twists shift(const_cast<double *>(numbers), 6, c->arms);
    if (!shift.allFinite()) return 0;
    if (grasps_move(c)) place_grasps(c, c->loop->clock, shift);
    else
        for (int k = 0; k < c->arms; k++) c->object[k] = compose(c->places[k], exp6(-shift.col(k)));
    expect_shift(c, shift);
    return 1;
}
