/* How far the commands lead the arms apart, as commanded.py defines it. */

#include "functions.h"

static double length6(const double *x) { return sqrt(dot3(x, x) + dot3(x + 3, x + 3)); }

/* The errors of the arms without their mean. */
static void among_arms(const Core *c, const double *errors, double *out) {
    double mean[6] = {};
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) mean[i] += errors[6 * k + i];
    for (int i = 0; i < 6; i++) mean[i] /= c->arms;
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) out[6 * k + i] = errors[6 * k + i] - mean[i];
}

/* Take the mismatch that is still to be corrected away from `away`; keep the share of it that is left. */
static void without_mismatch(Core *c, double *away) {
    const int count = 6 * c->arms;
    double along = 0.0, square = 0.0;
    for (int i = 0; i < count; i++) along += away[i] * c->mismatch[i], square += c->mismatch[i] * c->mismatch[i];
    const double left = square > 0.0 ? clamp(along / square, 0.0, 1.0) : 0.0;
    for (int i = 0; i < count; i++) away[i] -= left * c->mismatch[i];
    c->proposal->mismatch_left = left;
    c->proposal->mismatched = left * left * square > NO_MISMATCH * NO_MISMATCH;
}

/* The arm whose view of the object is furthest from another's. */
static int furthest_from(const Core *c, const double *away, int arm) {
    double most = -1.0;
    int other = 0;
    for (int k = 0; k < c->arms; k++) {
        double between[6];
        for (int i = 0; i < 6; i++) between[i] = away[6 * k + i] - away[6 * arm + i];
        const double distance = length6(between);
        if (k != arm && distance > most) most = distance, other = k;
    }
    return other;
}

/* After the errors: `apart`, and a hold where it is too large. */
static void watch_chain(Core *c) {
    Proposal *p = c->proposal;
    double *away = c->scratch, most = 0.0;
    const int n = c->arms;
    int arm = 0;
    if (n < 2) return;
    among_arms(c, c->errors, away);
    if (c->loop->started == 0.0) { /* whatever there is now is a mismatch of the start */
        memcpy(c->mismatch, away, 6 * sizeof(double) * (size_t)n);
        c->loop->mismatch = 1.0;
    }
    if (c->loop->mismatch != 0.0) without_mismatch(c, away);
    for (int k = 0; k < n; k++) { /* lengths at the grasps: displacement of their centre, and the turn about it */
        double *x = away + 6 * k;
        const double *L = c->at_grasps + 18;
        for (int i = 0; i < 3; i++) x[i] += x[3] * L[i] + x[4] * L[6 + i] + x[5] * L[12 + i];
        for (int i = 3; i < 6; i++) x[i] *= c->at_grasps[35];
        const double distance = length6(x);
        if (!(distance <= most * ALIKE)) most = distance, arm = k;
    }
    p->apart = most * n / (n - 1.0);
    const double limit = c->options->apart_hold * (c->loop->chain_held != 0.0 ? TOGETHER_AGAIN : 1.0);
    p->chain_holds = !(p->apart <= limit);
    if (p->apart <= SAID_APART || (p->reason != NO_REASON && !(p->watch_cap > 0.0 && p->chain_holds != 0.0))) return;
    const int other = furthest_from(c, away, arm), first = arm < other ? arm : other;
    if (p->chain_holds != 0.0)
        refuse(c, CHAIN_PARTED, first, p->apart);
    else
        p->reason = CHAIN_APART, p->reason_arm = first, p->reason_a = p->apart;
    p->reason_b = arm + other - first;
}

/* Once a step is made. */
static void chain_watched(Core *c) {
    const Proposal *p = c->proposal;
    if (p->has_errors == 0.0) return;
    c->loop->started = 1.0, c->loop->chain_held = p->chain_holds;
    const int known = p->made != 0.0 && p->parting == 0.0 && p->braked == 0.0;
    const int left = c->loop->mismatch != 0.0 && p->mismatched != 0.0;
    const double *asked = known ? asked_to_shift(c) : nullptr;
    const double closes = known ? p->grasp_share * p->closes : 0.0;
    for (int i = 0; (left || asked) && i < 6 * c->arms; i++) {
        const double still = left ? p->mismatch_left * c->mismatch[i] : 0.0;
        c->mismatch[i] = (1.0 - closes) * (asked ? still + asked[i] : still);
    }
    c->loop->mismatch = left || asked, c->loop->shift_asked = 0.0;
}

/* The grasps give way by other shifts: that parts the views of the object for a while, as it was asked for. */
static void expect_shift(Core *c, const double *shift) {
    double *change = c->scratch;
    if (!memcmp(c->grasp_shift, shift, 6 * sizeof(double) * (size_t)c->arms)) return;
    for (int i = 0; i < 6 * c->arms; i++) {
        change[i] = c->grasp_shift[i] - shift[i];
        c->grasp_shift[i] = shift[i];
        if (c->loop->mismatch == 0.0) c->mismatch[i] = 0.0;
    }
    among_arms(c, change, change);
    for (int i = 0; i < 6 * c->arms; i++) {
        c->mismatch[i] += change[i];
        c->asked_shift[i] = (c->loop->shift_asked != 0.0 ? c->asked_shift[i] : 0.0) - change[i];
    }
    c->loop->mismatch = c->loop->shift_asked = 1.0;
}
