/* Comparison of measured with commanded configurations: supervision, drift and forces.
 *
 * An arm that lags or stalls pulls on the object that the others carry on. For every arm the measured pose of the object
 * that it carries is compared with the commanded one, and the object slows down before the arms part too far. Deviations
 * common to all arms do not count: they only displace the object.
 *
 * Drift. If a base is not exactly at its modelled place, arms in a rigid grip seem to drift apart as the object moves
 * and turns: slowly, at rest as in motion. An arm that lags deviates by its speed times the lag. So the model of a
 * deviation is d = b + c s with the speed s of the joints, a slow drift b and a constant lag c. A Kalman filter
 * separates them; the remainder d − b is out of step.
 *
 * Forces. A servo of stiffness Kp that stands off its command pushes with Kp (q_command − q_measured); at the object
 * that is the wrench w_k = C_k⁻¹ A_k (q_command − q_measured) with the compliance C_k = A_k Kp⁻¹ A_kᵀ. An arm that does
 * not follow is dragged along, and at rest the total wrench points it straight back along its way: C_k Σ w is how far
 * its servos' target lags behind. Arms that share joints give way to each other's wrenches: there w = C⁻¹ A (q_command −
 * q_measured) with C of all arms, and arm k lags by (Σ_j (C⁻¹)_jk)⁻¹ Σ w.
 *
 * Noise is known by second differences, which motion hardly has. Positions are finite here, and comparisons that decide
 * are written so that NaN holds. */

#include "functions.h"

constexpr double STILL_COMMAND = 1e-5; /* commanded motion of an arm below this says nothing of a stall [rad or m] */
constexpr double FOLLOWS = 0.5; /* an arm that moves by more than this share of its command follows it */
constexpr double CAUGHT_UP = 5e-4; /* a stalled arm this close to its command has caught up [rad or m] */
constexpr double CAUGHT_UP_SHARE = 0.3; /* so has one at this share of the largest gap */
/* Arms this little apart in their distances count as equally far from their commands [m] */
constexpr double EQUALLY_FAR = 1e-6;
constexpr int FAULT_SAMPLES = 2; /* a fault needs as many samples in a row */
constexpr int MOST_LOST = 3; /* samples in a row that an arm may repeat before it counts as standing */
constexpr double NOISE_TIME = 0.2; /* noise is averaged over this time [s] */
constexpr double WANDER = 1e-3; /* how far a drift wanders within a second [m] */
constexpr double LEAST_LAG = 1e-4; /* how well the lag is known at best [s] */
constexpr double DRIFT_FLOOR = 5e-4; /* how well distances are known without noise [m] */
constexpr double DRIFT_SAMPLE = 1e-3; /* per this time [s] */
constexpr double SMOOTHING = 0.1; /* distances and speed are smoothed alike [s] */
constexpr double DRIFT_PERIOD = 0.0045; /* the filter runs this often, or at every step if that is longer [s] */
constexpr double AT_REST = 1e-3; /* commanded joint velocities below this are rest [rad/s or m/s] */
constexpr double SERVOS_SETTLED = 0.2; /* after this long at rest servos have settled [s] */
constexpr double UNBALANCED = 0.3; /* share of the largest wrench from which on wrenches do not cancel */
constexpr double PACE_TIME = 0.01; /* the pace of a force is seen over this time [s] */
/* A force from LET_GO of the limit on holds where its pace would bring it there in this time [s] */
constexpr double SOON = 0.025;
constexpr double STRAIGHT_BACK = 0.95; /* cosine from which on an arm's way back is taken for the cause */
constexpr double GROWS = 2e-3; /* closures of rigid grips also drift as fast as the object grows [m/s] */
/* The cap by arms out of step falls from 1 to 0 in this time: a jolt is a force of its own [s] */
constexpr double CAP_FALLS = 0.1;

/* Finding of one sample: a cap of the rate, and why it is below 1. */
struct Seen {
    double cap = 1.0;
    int hold = 0, fault = 0, arm = -1;
    Reason reason = NO_REASON;
    double a = 0.0, b = 0.0; /* numbers of the reason */
};

static void hold_for(Seen *seen, Reason reason, int arm, double a, double b) {
    seen->cap = 0.0;
    seen->hold = 1;
    seen->arm = arm, seen->reason = reason;
    seen->a = a, seen->b = b;
}

/* The larger of both; NaN stays NaN. */
static double larger(double a, double b) { return a >= b || isnan(a) ? a : b; }

/* Square of the largest length of some twists. */
static double largest_square(const Twists &x) {
    double largest = 0.0;
    for (int k = 0; k < x.cols(); k++) largest = larger(largest, x.col(k).squaredNorm());
    return largest;
}

/* -- distances ----------------------------------------------------------------------------------------------------- */

/* Displacements of the object as lengths at the grasps. */
static void to_grasps(const Core *c, const Twists &away, Twists &out) {
    for (int k = 0; k < c->arms; k++) out.col(k) = c->at_grasps.transpose().lazyProduct(away.col(k));
}

/* The mean of the arms. */
static Vector6 mean_of(const Twists &x) {
    Vector6 mean = x.col(0);
    for (int k = 1; k < x.cols(); k++) mean += x.col(k);
    return mean / (double)x.cols();
}

static bool holds(const Core *c, int k) { return c->holding[k] != 0.0; }

/* The mean of some arms, 0 without any; `which` has a number of each. */
template <class Which> static Vector6 mean_where(const Which &which, const Twists &x) {
    const double count = which.sum();
    Vector6 sum = Vector6::Zero();
    for (int k = 0; k < x.cols(); k++)
        if (which[k] != 0.0) sum += x.col(k);
    return count > 0.0 ? Vector6(sum / count) : sum;
}

/* How far each arm that holds the object is from the mean of the others that do; one that does not hold it from none. */
template <class Which> static void from_others(const Which &which, const Twists &x, Twists &out) {
    const double n = which.sum(), factor = n > 1.0 ? n / (n - 1.0) : 0.0;
    const Vector6 mean = mean_where(which, x);
    for (int k = 0; k < x.cols(); k++) out.col(k) = which[k] * factor * (x.col(k) - mean);
}

/* Has arm k sent the numbers of the sample before, to the last bit? */
static int repeats(const Core *c, int k, const double *q) {
    for (int i = 0; i < joints_behind(c, k); i++) {
        const int j = joint_behind(c, k, i), at = (int)c->q_index[j];
        if (q[at] != c->seen[at] || (c->continuous[j] != 0.0 && q[at + 1] != c->seen[at + 1])) return 0;
    }
    return 1;
}

static int has_lost(const Core *c, int k) { return c->lost[k] > 0.0 && c->lost[k] <= MOST_LOST; }

/* A lost sample says nothing: the distance stays as it was. */
static void keep_where_lost(Core *c, const double *q, Twists &away) {
    for (int k = 0; k < c->arms; k++) {
        c->lost[k] = c->watch->has_seen && repeats(c, k, q) ? c->lost[k] + 1.0 : 0.0;
        if (has_lost(c, k)) away.col(k) = c->away.col(k);
    }
    memcpy(c->seen, q, sizeof(double) * (size_t)c->nq);
    c->watch->has_seen = true;
}

/* Noise in unfiltered deviations of arms that hold [m, rms], from their second differences, which motion hardly has. */
static double noise_seen(const Core *c, double *samples, Twists &last, Twists &last_step, double *noise,
                         const Twists &away, double dt) {
    double largest = 0.0;
    *samples = min_of(*samples + 1.0, NOISE_TIME / dt);
    const double gain = 1.0 / max_of(*samples - 2.0, 1.0);
    for (int k = 0; k < away.cols(); k++) {
        const Vector6 step = away.col(k) - last.col(k), bend = step - last_step.col(k);
        last.col(k) = away.col(k), last_step.col(k) = step;
        if (*samples > 2.0) noise[k] += gain * (bend.squaredNorm() - noise[k]); /* the first have no past */
        if (holds(c, k)) largest = larger(largest, noise[k]);
    }
    return sqrt(largest / 6.0);
}

/* -- drift --------------------------------------------------------------------------------------------------------- */

/* Changes of the drift that the filter asks for. The part towards 0 is done; the rest, its growth, is left in `change`.
 * Returns the largest growth. */
static double shrink_drift(Core *c, double *change) {
    double largest = 0.0;
    double *drifts = c->slow_drift;
    for (int i = 0; i < 6 * c->arms; i++) {
        double *drift = drifts + i, shrunk = 0.0;
        if (change[i] * *drift < 0.0) shrunk = copysign(min_of(fabs(change[i]), fabs(*drift)), change[i]);
        *drift += shrunk;
        change[i] -= shrunk;
        largest = larger(largest, fabs(change[i]));
    }
    return largest;
}

/* One step of the filter of least variance for distance = drift + lag speed; the drift grows by `most` at most. */
static void update_drift(Core *c, const Twists &apart, double noise, double speed, double most, double dt,
                         Twists &change) {
    Watch *w = c->watch;
    const double fresh = dt / (SMOOTHING + dt), limit = c->options->drift_limit;
    w->drift_speed += fresh * (speed - w->drift_speed);
    w->drift_variance += WANDER * WANDER * dt;
    const double s = w->drift_speed;
    const double hb = w->drift_variance + w->drift_lag_covariance * s, hc = w->drift_lag_covariance + w->lag_variance * s;
    const double scale = 1.0 / (hb + hc * s + (DRIFT_FLOOR * DRIFT_FLOOR + noise * noise) * DRIFT_SAMPLE / dt);
    c->apart += fresh * (apart - c->apart);
    for (int k = 0; k < c->arms; k++) {
        const Vector6 surprise = c->apart.col(k) - c->slow_drift.col(k) - s * c->lag.col(k);
        c->lag.col(k) += scale * hc * surprise;
        change.col(k) = scale * hb * surprise;
    }
    const double largest = shrink_drift(c, change);
    const double share = largest > most ? most / largest : 1.0;
    c->slow_drift = (c->slow_drift + share * change).cwiseMax(-limit).cwiseMin(limit);
    w->drift_variance = max_of(w->drift_variance - scale * hb * hb, 0.0);
    w->drift_lag_covariance -= scale * hb * hc;
    /* Too fast for a drift: the lag may have changed. */
    w->lag_variance = largest > most ? LAG * LAG : max_of(w->lag_variance - scale * hc * hc, LEAST_LAG * LEAST_LAG);
}

/* Distances without the drift. */
static void without_drift(Core *c, const Twists &apart, double noise, double dt, Twists &out) {
    Watch *w = c->watch;
    w->drift_since += dt;
    if (!w->drift_started) {
        c->drift_last = c->positions;
        w->drift_started = true;
    } else if (w->drift_since >= DRIFT_PERIOD) {
        const double way = (c->positions - c->drift_last).cwiseAbs().maxCoeff(); /* joints count with a lever of 1 m */
        c->drift_last = c->positions;
        update_drift(c, apart, noise, way / w->drift_since, LARGEST_SLOPE * way, w->drift_since, out);
        w->drift_since = 0.0;
    }
    out = apart - c->slow_drift;
}

/* Distances of rigid grips, which have no lag in them, without a drift that follows them at once. */
static void follow_drift(Core *c, const Twists &apart, double dt, Twists &out) {
    const double limit = c->options->drift_limit, started = c->watch->drift_started;
    const double way = started != 0.0 ? (c->positions - c->drift_last).cwiseAbs().maxCoeff() : 0.0;
    c->drift_last = c->positions;
    c->watch->drift_started = true;
    c->relaxation->joint_way = way;
    out = apart - c->slow_drift;
    const double share = min_of((LARGEST_SLOPE * way + GROWS * dt) / max_of(out.cwiseAbs().maxCoeff(), 1e-300), 1.0);
    c->slow_drift = (c->slow_drift + share * out).cwiseMax(-limit).cwiseMin(limit);
    out = apart - c->slow_drift;
}

/* Other arms hold than before: the drift with which those that go on are as far out of step as they were, and one that
 * attaches is not. */
static void carry_drift(const Core *c, const Twists &values, Twists &drift, Twists &base) {
    const auto go_on = c->held.cwiseProduct(c->holding);
    const double held = c->held.sum(), share = held > 1.0 ? (held - 1.0) / held : 0.0;
    base = values - share * drift;
    const Vector6 rest = mean_where(go_on, base);
    for (int k = 0; k < c->arms; k++)
        if (go_on[k] != 0.0)
            base.col(k) = share * drift.col(k);
        else
            base.col(k) = values.col(k) - rest;
    from_others(c->holding, base, drift);
}

/* Of arms that relax forces; see residual.cpp. */
static void carry_servos(Core *c, Twists &base);

static void take_over(Core *c, Twists &base) {
    const double limit = c->options->drift_limit;
    if (c->watch->lag_time != 0.0)
        c->lag_base += mean_where(c->holding, c->deviation) - mean_where(c->held, c->deviation);
    carry_drift(c, c->deviation, c->slow_drift, base);
    c->slow_drift = c->slow_drift.cwiseMax(-limit).cwiseMin(limit);
    if (c->relaxation) carry_servos(c, base);
    from_others(c->holding, c->deviation, c->apart);
    c->lag.setZero();
    c->watch->lag_variance = LAG * LAG, c->watch->drift_lag_covariance = 0.0;
    c->held = c->holding;
}

/* -- out of step --------------------------------------------------------------------------------------------------- */

/* Count the samples in a row in which an arm is as far from the others as a fault needs. One that the arm farthest from
 * its command has lost says nothing. */
static void count_far(Core *c, const Twists &away, const Twists &apart, const Twists &out_of_step, Twists &unfiltered) {
    int farthest = 0;
    double most = -1.0;
    for (int k = 0; k < c->arms; k++) {
        const double own = away.col(k).squaredNorm();
        if (holds(c, k) && own > most) most = own, farthest = k;
    }
    if (has_lost(c, farthest)) return;
    from_others(c->holding, away, unfiltered);
    unfiltered -= apart - out_of_step;
    const double limit = c->options->fault_from;
    const int far = largest_square(unfiltered) >= limit * limit;
    c->watch->far_samples = far ? c->watch->far_samples + 1 : 0;
}

static double own_distance(const Core *c, int k) { return c->deviation.col(k).norm(); }

static int as_far(const Twists &out_of_step, int k, double largest) {
    return out_of_step.col(k).norm() >= 0.99 * largest;
}

/* Of arms equally far from the others, as two arms always are, the one that is not where it should be; of several, the
 * one that was named last, or the first. */
static int most_out_of_step(const Core *c, const Twists &out_of_step, double largest) {
    const int last = c->watch->cap_arm;
    double most = -1.0;
    int arm = -1;
    for (int k = 0; k < c->arms; k++)
        if (as_far(out_of_step, k, largest)) most = max_of(most, own_distance(c, k));
    for (int k = c->arms - 1; k >= 0; k--)
        if (as_far(out_of_step, k, largest) && own_distance(c, k) > most - EQUALLY_FAR && (arm < 0 || arm != last))
            arm = k;
    return arm < 0 ? 0 : arm;
}

/* Deviation of each arm from the mean of the others that slows or stops the object. */
static void watch_distances(Core *c, const double *q, const Twists &away_given, double dt, int rigid, Seen *seen) {
    const Options *o = c->options;
    const auto scratch = [&](int i) { return Twists(c->scratch + 6 * i * c->arms, 6, c->arms); };
    Twists away = scratch(0), apart = scratch(1), out_of_step = scratch(2), unfiltered = scratch(3);
    to_grasps(c, away_given, away);
    keep_where_lost(c, q, away);
    if ((c->held.array() != c->holding.array()).any()) take_over(c, apart);
    c->deviation += dt / (o->filter_time + dt) * (away - c->deviation);
    const double share = sqrt(dt / (2.0 * o->filter_time + dt)); /* of the noise that passes the filter */
    const double noise = share * noise_seen(c, &c->watch->noise_samples, c->away, c->away_step, c->noise, away, dt);
    from_others(c->holding, c->deviation, apart);
    if (o->drift_limit > 0.0 && rigid)
        follow_drift(c, apart, dt, out_of_step);
    else if (o->drift_limit > 0.0)
        without_drift(c, apart, noise, dt, out_of_step);
    else
        out_of_step = apart;
    count_far(c, away, apart, out_of_step, unfiltered);
    const double largest = sqrt(largest_square(out_of_step));
    const double worst = largest - o->noise_margin * noise;
    c->watch->lag_noise = o->noise_margin * noise / sqrt(max_of(c->holding.sum(), 1.0)) + max_of(worst, 0.0); /* see watch_lag() */
    if (worst <= o->slow_from || c->watch->noise_samples < FEW_SAMPLES) return;
    const int arm = most_out_of_step(c, out_of_step, largest);
    hold_for(seen, OUT_OF_STEP_BY, arm, out_of_step.col(arm).norm(), 0.0);
    seen->fault = worst >= o->fault_from && c->watch->far_samples >= FAULT_SAMPLES;
    if (!(worst < o->hold_from)) return;
    seen->hold = 0;
    seen->cap = (o->hold_from - worst) / (o->hold_from - o->slow_from);
}

/* -- stalls -------------------------------------------------------------------------------------------------------- */

/* The sample so many samples before the last one, or the oldest. */
static const double *sample_before(const Core *c, int samples) {
    const int count = c->watch->past_count, last = c->watch->past_head + c->past - 1;
    return c->history + 2 * (size_t)c->joints * (size_t)((last - (samples < count ? samples : count - 1)) % c->past);
}

/* Keep this sample in the ring. */
static void remember(Core *c, const double *positions) {
    Watch *w = c->watch;
    const size_t joints = (size_t)c->joints;
    double *slot = c->history + 2 * joints * (size_t)w->past_head;
    memcpy(slot, positions, sizeof(double) * joints);
    memcpy(slot + joints, c->positions, sizeof(double) * joints);
    w->past_head = w->past_head + 1 < c->past ? w->past_head + 1 : 0;
    w->past_count = std::min(w->past_count + 1, c->past);
}

/* The least of the largest motions that the joints of arm k were commanded to make in as many samples, now or up to LAG ago: one
 * of them is what a late arm should have made. */
static double least_told(const Core *c, int k, double told) {
    const int samples = c->options->stall_samples, n = joints_behind(c, k);
    const int late = c->watch->past_count - 1 - samples;
    for (int i = 1; i <= late; i++) {
        const double *from = sample_before(c, samples + i) + c->joints, *to = sample_before(c, i) + c->joints;
        double most = 0.0;
        for (int m = 0; m < n; m++) most = max_of(most, fabs(to[joint_behind(c, k, m)] - from[joint_behind(c, k, m)]));
        told = min_of(told, most);
    }
    return told;
}

/* Largest motions of the joints of arm k since an older sample, as commanded and measured, and what lies between. */
static void moves_of(const Core *c, int k, const double *positions, const double *before, double *told, double *moved,
                     double *gap) {
    double most[3] = {};
    for (int m = 0; m < joints_behind(c, k); m++) {
        const int j = joint_behind(c, k, m);
        double commanded = c->positions[j];
        double size[3] = {fabs(commanded - before[c->joints + j]), fabs(positions[j] - before[j]),
                          fabs(commanded - positions[j])};
        for (int i = 0; i < 3; i++) most[i] = size[i] > most[i] ? size[i] : most[i];
    }
    *told = most[0], *moved = most[1], *gap = most[2];
}

/* Arms that are close to their commands again have not stalled any more. */
static void let_go_who_caught_up(Core *c, const double *gap) {
    int any = 0;
    for (int k = 0; k < c->arms; k++) any |= c->stalled[k] != 0.0;
    if (!any) return;
    for (int k = 0; k < c->arms; k++) {
        c->widest[k] = max_of(c->widest[k], gap[k]);
        if (gap[k] < max_of(CAUGHT_UP, CAUGHT_UP_SHARE * c->widest[k])) c->stalled[k] = 0.0;
    }
}

/* An arm that stands while another follows has stalled; where none follows, signals may just be late. */
static void note_stalls(Core *c, const double *told, const double *moved, const double *gap, double dt) {
    const Options *o = c->options;
    double *stands = c->scratch + 3 * c->arms, *silence = &c->watch->silence;
    int any = 0, follows = 0;
    for (int k = 0; k < c->arms; k++) {
        int moving = told[k] > STILL_COMMAND;
        /* With less of a gap it is not stalled but late; so it is where it turns round a little later than told. */
        int still = moving && moved[k] < o->stall_share * told[k] && gap[k] >= CAUGHT_UP;
        if (still) {
            const double least = least_told(c, k, told[k]);
            still = least > STILL_COMMAND && moved[k] < o->stall_share * least;
        }
        stands[k] = still;
        any |= still;
        follows |= moving && moved[k] > FOLLOWS * told[k];
    }
    const int full = c->watch->past_count > o->stall_samples;
    *silence = full && any && !follows ? *silence + dt : 0.0;
    if (!full || !any || !(follows || *silence > o->silent_time)) return;
    for (int k = 0; k < c->arms; k++) {
        if (stands[k] == 0.0) continue;
        if (c->stalled[k] == 0.0) c->widest[k] = 0.0;
        c->stalled[k] = 1.0;
    }
}

/* Of arms in rigid grips that relax forces, their wrenches say more: here, only whether all have stopped. */
static void watch_stall(Core *c, const double *positions, double dt, int rigid, Seen *seen) {
    double *told = c->scratch, *moved = told + c->arms, *gap = moved + c->arms;
    remember(c, positions);
    const double *before = sample_before(c, c->options->stall_samples);
    for (int k = 0; k < c->arms; k++) moves_of(c, k, positions, before, told + k, moved + k, gap + k);
    let_go_who_caught_up(c, gap);
    note_stalls(c, told, moved, gap, dt);
    int first = -1, all = 1;
    for (int k = c->arms - 1; k >= 0; k--) {
        if (c->stalled[k] != 0.0)
            first = k;
        else
            all = 0;
    }
    if (first >= 0 && (all || !rigid)) hold_for(seen, all ? ALL_STALLED : STALLED, first, 0.0, 0.0);
}

/* -- forces from the servos ---------------------------------------------------------------------------------------- */

/* x of A x = b for a symmetric A of which the lower triangle is read and overwritten by its factors L D Lᵀ; b becomes x.
 * Without a pivot it is not finite. */
template <typename Symmetric, typename Numbers>
static void solve_symmetric(Symmetric &A, Numbers &&b) {
    const int n = (int)A.rows();
    for (int j = 0; j < n; j++)
        for (int i = j + 1; i < n; i++) {
            const double factor = A(i, j) / A(j, j);
            for (int m = j + 1; m <= i; m++) A(i, m) -= factor * A(m, j);
            b[i] -= factor * b[j];
        }
    for (int i = n - 1; i >= 0; i--) {
        for (int m = i + 1; m < n; m++) b[i] -= A(m, i) * b[m]; /* columns still carry D */
        b[i] /= A(i, i);
    }
}

/* Compliance C_k of the servos of an arm's own joints at the object, and how the deflection of all behind it bends it. */
static void comply(const Core *c, int k, const Twists &jacobian, Eigen::Map<Matrix6> C, Ref6 bent) {
    const ArmJoints &a = joints_of(c, k);
    C.setZero(), bent.setZero();
    for (int i = 0; i < a.n; i++) {
        const Vector6 column = jacobian.col(a.own(i));
        C += c->softness[a.own(i)] * column * column.transpose();
        bent += c->deflection[a.own(i)] * column;
    }
    for (int i = 0; i < a.shared; i++) bent += c->deflection[a.joint[i]] * jacobian.col(a.joint[i]);
}

/* Compliance of the joints that two arms of a group share: by it each gives way to the other's wrench. */
static Matrix6 comply_together(const Core *c, const Group &g, int one, int other, const Twists &jacobian) {
    Matrix6 C = Matrix6::Zero();
    for (int j = 0; j < g.shared; j++) {
        if (!g.moves[one][j] || !g.moves[other][j]) continue;
        const Vector6 column = jacobian.col(g.joint[j]);
        C += c->softness[g.joint[j]] * column * column.transpose();
    }
    return C;
}

/* The compliance of a group, of which the lower triangle counts. */
static GroupGram compliance_of(const Core *c, const Group &g, const Twists &jacobian, const double *C) {
    GroupGram A = GroupGram::Zero(6 * g.arms, 6 * g.arms);
    for (int i = 0; i < g.arms; i++) {
        for (int j = 0; j <= i; j++) A.block<6, 6>(6 * i, 6 * j) = comply_together(c, g, i, j, jacobian);
        A.block<6, 6>(6 * i, 6 * i) += Eigen::Map<const Matrix6>(C + 36 * g.arm[i]);
    }
    A.diagonal().array() += STRUCTURE;
    return A;
}

/* The wrenches of the servos of a group, from how its arms are bent, in their place. */
static void push_together(const Core *c, const Group &g, const Twists &jacobian, const double *C, Twists &wrenches) {
    GroupGram A = compliance_of(c, g, jacobian, C);
    GroupTwists bent = GroupTwists::Zero(6 * g.arms);
    for (int i = 0; i < g.arms; i++) bent.segment<6>(6 * i) = wrenches.col(g.arm[i]);
    solve_symmetric(A, bent);
    for (int i = 0; i < g.arms; i++) wrenches.col(g.arm[i]) = bent.segment<6>(6 * i);
}

/* By how much the servos' target of arm k, which shares joints, would lag behind for the total wrench: all arms of the group feel
 * where it is. */
static Vector6 lag_of_one(const Core *c, const Group &g, int k, const Twists &jacobian, const double *C, const Vector6 &total) {
    const GroupGram whole = compliance_of(c, g, jacobian, C);
    Rows<> felt;
    int m = 0;
    while (g.arm[m] != k) m++;
    for (int i = 0; i < 6; i++) {
        GroupGram A = whole;
        GroupTwists all = GroupTwists::Zero(6 * g.arms);
        for (int arm = 0; arm < g.arms; arm++) all[6 * arm + i] = 1.0;
        solve_symmetric(A, all);
        for (int j = 0; j < 6; j++) felt[i][j / 2][j % 2] = all[6 * m + j];
        felt[i][3] = pair{total[i], 0.0};
    }
    Vector6 lag = Vector6::Zero();
    if (solve6<1>(felt) > 0.0)
        for (int i = 0; i < 6; i++) lag[i] = felt[i][3][0];
    return lag;
}

/* Filter the deflection of the servos; find the commanded velocity. Returns whether all joints rest. */
static int deflect(Core *c, const double *positions, double dt, double *velocity) {
    const Options *o = c->options;
    const double fresh = dt / (o->filter_time + dt), known = c->watch->has_commanded;
    double fastest = 0.0;
    const auto bend = [&](int j) {
        velocity[j] = known != 0.0 ? (c->positions[j] - c->commanded[j]) / dt : 0.0;
        const double off = c->positions[j] - positions[j] - o->servo_delay * velocity[j];
        c->deflection[j] += fresh * (off - c->deflection[j]);
        fastest = fabs(velocity[j]) > fastest ? fabs(velocity[j]) : fastest;
    };
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < joints_of(c, k).n; i++) bend(joints_of(c, k).own(i));
    for (int g = 0; g < c->groups; g++)
        for (int i = 0; i < c->group[g].shared; i++) bend(c->group[g].joint[i]);
    c->commanded = c->positions;
    c->watch->has_commanded = true;
    return fastest <= AT_REST;
}

/* Cosine between the way back that a wrench asks of arm k and its last motion. */
static double straightness(const Core *c, int k, const Twists &jacobian, const Vector6 &back) {
    Vector6 way = Vector6::Zero(), scaled = back;
    for (int i = 0; i < joints_behind(c, k); i++) way += c->way[joint_behind(c, k, i)] * jacobian.col(joint_behind(c, k, i));
    way.tail<3>() *= TURN_LENGTH, scaled.tail<3>() *= TURN_LENGTH;
    return scaled.dot(way) / max_of(scaled.norm() * way.norm(), 1e-300);
}

/* At rest, the arm that the total wrench puts straight back along its way does not follow its command. */
static void find_behind(Core *c, const Twists &jacobian, const double *C, const Twists &wrenches, double largest) {
    Watch *w = c->watch;
    double straightest = STRAIGHT_BACK;
    const Vector6 total = (double)c->arms * mean_of(wrenches);
    if (!(total.head<3>().norm() > UNBALANCED * largest)) return;
    for (int k = 0; k < c->arms; k++) {
        Vector6 back = Eigen::Map<const Matrix6>(C + 36 * k) * total;
        if (const Group *g = group_of(c, k)) back = lag_of_one(c, *g, k, jacobian, C, total);
        const double straight = straightness(c, k, jacobian, back);
        if (!(straight > straightest)) continue;
        straightest = straight;
        w->behind = k;
        w->behind_gap = back.head<3>().norm();
        w->behind_pull = (total - wrenches.col(k)).head<3>().norm();
    }
}

/* Jacobians about the object as arm 0 carries it at the measured positions. */
static void linearise_measured(const Core *c, const double *positions, Pose *carried, Twists &jacobian) {
    const Vector3 &near = c->carried[0].p; /* any point would do: nearby ones lose no digits */
    carry_and_linearise(c, positions, near, carried, jacobian);
    const Vector3 shift = carried[0].p - near;
    for (int j = 0; j < c->joints; j++) jacobian.col(j) = twist_at(jacobian.col(j), shift);
}

/* Read the force at each grasp, and the arm that lags. Returns the arm with the largest force. */
static int read_forces(Core *c, const double *positions, double dt) {
    const int n = c->arms, nv = c->joints;
    double *C = c->scratch + 12 * n, *velocity = C + 42 * n + 6 * nv;
    Watch *w = c->watch;
    Twists wrenches(C + 36 * n, 6, n), jacobian(C + 42 * n, 6, nv);
    const int rests = deflect(c, positions, dt, velocity);
    linearise_measured(c, positions, reinterpret_cast<Pose *>(c->scratch), jacobian);
    int most = 0;
    for (int k = 0; k < n; k++) {
        Eigen::Map<Matrix6> own(C + 36 * k);
        comply(c, k, jacobian, own, wrenches.col(k));
        if (group_of(c, k)) continue;
        Matrix6 factored = own;
        factored.diagonal().array() += STRUCTURE;
        solve_symmetric(factored, wrenches.col(k));
    }
    for (int i = 0; i < c->groups; i++) push_together(c, c->group[i], jacobian, C, wrenches);
    for (int k = 0; k < n; k++) {
        if (!holds(c, k)) wrenches.col(k).setZero(); /* nothing presses on it */
        c->forces[k] = wrenches.col(k).head<3>().norm();
        if (larger(c->forces[most], c->forces[k]) != c->forces[most]) most = k;
    }
    w->behind = -1;
    if (!rests) {
        for (int k = 0; k < n; k++) {
            for (int i = 0; i < joints_behind(c, k); i++) c->way[joint_behind(c, k, i)] = velocity[joint_behind(c, k, i)];
        }
        w->rest_time = 0.0;
        return most;
    }
    w->rest_time += dt;
    if (w->rest_time > SERVOS_SETTLED) find_behind(c, jacobian, C, wrenches, c->forces[most]);
    return most;
}

/* What the force of arm k comes to soon at its pace, from LET_GO of the limit on. */
static double force_soon(Core *c, int k, double dt) {
    c->slow_forces[k] += dt / (PACE_TIME + dt) * (c->forces[k] - c->slow_forces[k]);
    if (!(c->forces[k] >= LET_GO * c->options->force_limit)) return c->forces[k];
    return c->forces[k] + SOON / PACE_TIME * max_of(c->forces[k] - c->slow_forces[k], 0.0);
}

/* Arms that press too hard on the object, or soon will, hold it until they press less than half as hard. */
static void watch_forces(Core *c, const double *positions, double dt, Seen *seen) {
    Watch *w = c->watch;
    const double limit = c->options->force_limit;
    const int most = read_forces(c, positions, dt);
    double soon = 0.0;
    for (int k = 0; k < c->arms; k++) {
        const double own = force_soon(c, k, dt);
        if (k == most) soon = own;
    }
    const double force = c->forces[most];
    w->force_holds = !(soon < (w->force_holds ? LET_GO * limit : limit));
    if (!w->force_holds) return;
    if (w->behind < 0)
        hold_for(seen, force < limit && soon >= limit ? FORCE_GROWS : FORCE, most, force, soon);
    else
        hold_for(seen, HANGS_BEHIND, w->behind, w->behind_gap, w->behind_pull);
}

/* Of arms that relax forces; see residual.cpp. */
static void add_shift(const Core *c, Twists &away);
static void watch_servos(Core *c, const Twists &away, double dt, Seen *seen);
static void watch_lag(Core *c, double dt, Seen *seen);

/* -- one sample ---------------------------------------------------------------------------------------------------- */

static int all_finite(const Core *c, const double *positions, const Twists &away, double dt) {
    int finite = dt > 0.0 && dt <= DBL_MAX;
    for (int j = 0; j < c->joints; j++) finite &= fabs(positions[j] - c->positions[j]) <= DBL_MAX;
    return finite && away.allFinite();
}

/* A slowed object is let go at such a pace that it takes a while from rest. */
static void recover(Core *c, double dt, Seen *seen) {
    Watch *w = c->watch;
    const double allowed = w->rate_cap + dt / c->options->recovery_time;
    if (allowed < seen->cap) {
        seen->cap = allowed;
        if (seen->reason == NO_REASON) seen->reason = WAS_OUT_OF_STEP, seen->arm = w->cap_arm;
    }
    w->rate_cap = seen->cap;
    w->cap_arm = seen->arm;
}

/* Slow arms that are out of step down gently: a jolt would be a force of its own. */
static void fall_gently(const Core *c, double dt, Seen *seen) {
    const double least = c->watch->rate_cap - dt / CAP_FALLS;
    if (seen->fault || !(least > seen->cap)) return;
    seen->cap = least, seen->hold = 0;
}

static void watch_sample(Core *c, const double *positions, const double *q, const Twists &away, double dt) {
    const Options *o = c->options;
    const int relaxes = c->arms > 1 && c->relaxation && c->relaxation->rigid;
    Proposal *out = c->proposal;
    Twists &moved = c->measured_moved;
    Seen seen;
    if (!all_finite(c, positions, away, dt)) {
        hold_for(&seen, NOT_FINITE, -1, 0.0, 0.0);
    } else {
        moved = away;
        if (relaxes) add_shift(c, moved);
        if (c->arms > 1 && o->slow_from >= 0.0) watch_distances(c, q, moved, dt, relaxes, &seen);
        if (relaxes) fall_gently(c, dt, &seen);
        if (relaxes && o->slow_from >= 0.0) watch_servos(c, away, dt, &seen);
        if (o->stall_samples > 0) watch_stall(c, positions, dt, relaxes, &seen);
        if (o->watches_force) watch_forces(c, positions, dt, &seen);
        if (c->arms > 1 && !c->relaxation && c->holding.sum() > 1.0 && !o->watches_force && o->slow_from >= 0.0)
            watch_lag(c, dt, &seen);
        if (o->recovery_time > 0.0) recover(c, dt, &seen);
        if (c->relaxation && c->relaxation->touches != 0.0 && !seen.fault) hold_for(&seen, TOUCHING, -1, 0.0, 0.0); /* at once */
    }
    if (out->is_fault || !(seen.cap < out->watch_cap || seen.fault)) return; /* a fault stays as it is */
    out->watch_cap = seen.cap;
    out->hold = seen.hold, out->is_fault = seen.fault;
    out->reason = seen.reason, out->reason_index = seen.arm;
    out->reason_a = seen.a, out->reason_b = seen.b;
}

static void watch_reset(Core *c) {
    *c->watch = Watch();
    c->watch->rate_cap = 1.0;
    c->watch->cap_arm = c->watch->behind = -1;
    c->watch->lag_variance = LAG * LAG;
    for (Vector *x : {&c->noise, &c->stalled, &c->widest, &c->lost, &c->held, &c->forces, &c->slow_forces}) x->setZero();
    for (Twists *x : {&c->deviation, &c->away, &c->away_step, &c->slow_drift, &c->lag, &c->apart}) x->setZero();
    for (Twist *x : {&c->lag_base, &c->lag_told, &c->lag_way}) x->setZero();
    for (Vector *x : {&c->told_velocity, &c->deflection, &c->way}) x->setZero();
}
