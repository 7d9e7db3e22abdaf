/* Comparison of measured with commanded configurations: supervision, drift and forces, as supervision.py, drift.py and
 * stress.py define them.
 *
 * Positions are finite here, and comparisons that decide are written so that NaN holds. */

#include "functions.h"

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

static double square6(const double *x) { return dot3(x, x) + dot3(x + 3, x + 3); }

/* The larger of both; NaN stays NaN. */
static double larger(double a, double b) { return a >= b || isnan(a) ? a : b; }

static double largest_square6(const Core *c, const double *x) {
    double largest = 0.0;
    for (int k = 0; k < c->arms; k++) largest = larger(largest, square6(x + 6 * k));
    return largest;
}

/* -- distances ----------------------------------------------------------------------------------------------------- */

/* Displacements of the object as lengths at the grasps. */
static void to_grasps(const Core *c, const double *away, double *out) {
    memset(out, 0, sizeof(double) * 6 * (size_t)c->arms);
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++)
            for (int j = 0; j < 6; j++) out[6 * k + j] += away[6 * k + i] * c->at_grasps[6 * i + j];
}

/* How far each arm is from the mean of the others. */
static void from_others(const Core *c, const double *x, double *out) {
    const double n = c->arms, factor = n / (n - 1.0);
    double mean[6] = {};
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) mean[i] += x[6 * k + i];
    for (int i = 0; i < 6; i++) mean[i] /= n;
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) out[6 * k + i] = factor * (x[6 * k + i] - mean[i]);
}

/* Has arm k sent the numbers of the sample before, to the last bit? */
static int repeats(const Core *c, int k, const double *q) {
    const int last = (int)c->arm_start[k] + (int)c->arm_size[k] - 1;
    const int begin = (int)c->q_index[(int)c->arm_start[k]];
    const int end = (int)c->q_index[last] + (c->continuous[last] != 0.0 ? 2 : 1);
    for (int i = begin; i < end; i++)
        if (q[i] != c->seen[i]) return 0;
    return 1;
}

static int has_lost(const Core *c, int k) { return c->lost[k] > 0.0 && c->lost[k] <= MOST_LOST; }

/* A lost sample says nothing: the distance stays as it was. */
static void keep_where_lost(Core *c, const double *q, double *away) {
    for (int k = 0; k < c->arms; k++) {
        c->lost[k] = c->watch->has_seen != 0.0 && repeats(c, k, q) ? c->lost[k] + 1.0 : 0.0;
        if (has_lost(c, k)) memcpy(away + 6 * k, c->away + 6 * k, 6 * sizeof(double));
    }
    memcpy(c->seen, q, sizeof(double) * (size_t)c->nq);
    c->watch->has_seen = 1.0;
}

/* Noise in unfiltered deviations (6 an arm) [m, rms], from their second differences, which motion hardly has. */
static double noise_seen(int arms, double *samples, double *lasts, double *last_steps, double *noise, const double *away,
                         double dt) {
    double largest = 0.0;
    *samples = fmin(*samples + 1.0, NOISE_TIME / dt);
    const double gain = 1.0 / fmax(*samples - 2.0, 1.0);
    for (int k = 0; k < arms; k++) {
        double *last = lasts + 6 * k, *last_step = last_steps + 6 * k, bend[6];
        for (int i = 0; i < 6; i++) {
            double step = away[6 * k + i] - last[i];
            bend[i] = step - last_step[i];
            last[i] = away[6 * k + i], last_step[i] = step;
        }
        if (*samples > 2.0) noise[k] += gain * (square6(bend) - noise[k]); /* the first have no past */
        largest = larger(largest, noise[k]);
    }
    return sqrt(largest / 6.0);
}

/* -- drift --------------------------------------------------------------------------------------------------------- */

/* Changes of the drift that the filter asks for. The part towards 0 is done; the rest, its growth, is left in `change`.
 * Returns the largest growth. */
static double shrink_drift(Core *c, double *change) {
    double largest = 0.0;
    for (int i = 0; i < 6 * c->arms; i++) {
        double *drift = c->slow_drift + i, shrunk = 0.0;
        if (change[i] * *drift < 0.0) shrunk = copysign(fmin(fabs(change[i]), fabs(*drift)), change[i]);
        *drift += shrunk;
        change[i] -= shrunk;
        largest = larger(largest, fabs(change[i]));
    }
    return largest;
}

/* One step of the filter of least variance for distance = drift + lag speed; the drift grows by `most` at most. */
static void update_drift(Core *c, const double *apart, double noise, double speed, double most, double dt,
                         double *change) {
    Watch *w = c->watch;
    const double fresh = dt / (SMOOTHING + dt), limit = c->options->let_in;
    w->drift_speed += fresh * (speed - w->drift_speed);
    w->var_drift += WANDER * WANDER * dt;
    const double s = w->drift_speed;
    const double hb = w->var_drift + w->covariance * s, hc = w->covariance + w->var_lag * s;
    const double scale = 1.0 / (hb + hc * s + (DRIFT_FLOOR * DRIFT_FLOOR + noise * noise) * DRIFT_SAMPLE / dt);
    for (int i = 0; i < 6 * c->arms; i++) {
        c->apart[i] += fresh * (apart[i] - c->apart[i]);
        double surprise = c->apart[i] - c->slow_drift[i] - s * c->lag[i];
        c->lag[i] += scale * hc * surprise;
        change[i] = scale * hb * surprise;
    }
    const double largest = shrink_drift(c, change);
    const double share = largest > most ? most / largest : 1.0;
    for (int i = 0; i < 6 * c->arms; i++)
        c->slow_drift[i] = clamp(c->slow_drift[i] + share * change[i], -limit, limit);
    w->var_drift = fmax(w->var_drift - scale * hb * hb, 0.0);
    w->covariance -= scale * hb * hc;
    /* Too fast for a drift: the lag may have changed. */
    w->var_lag = largest > most ? LAG * LAG : fmax(w->var_lag - scale * hc * hc, LEAST_LAG * LEAST_LAG);
}

/* Distances without the drift. */
static void without_drift(Core *c, const double *apart, double noise, double dt, double *out) {
    Watch *w = c->watch;
    w->drift_since += dt;
    if (w->drift_started == 0.0) {
        memcpy(c->drift_last, c->positions, sizeof(double) * (size_t)c->joints);
        w->drift_started = 1.0;
    } else if (w->drift_since >= DRIFT_PERIOD) {
        double way = 0.0; /* joints count with a lever of 1 m */
        for (int j = 0; j < c->joints; j++) {
            double moved = fabs(c->positions[j] - c->drift_last[j]);
            way = moved > way ? moved : way;
            c->drift_last[j] = c->positions[j];
        }
        update_drift(c, apart, noise, way / w->drift_since, LARGEST_SLOPE * way, w->drift_since, out);
        w->drift_since = 0.0;
    }
    for (int i = 0; i < 6 * c->arms; i++) out[i] = apart[i] - c->slow_drift[i];
}

/* Distances of rigid grips, which have no lag in them, without a drift that follows them at once. */
static void follow_drift(Core *c, const double *apart, double dt, double *out) {
    double way = 0.0, fastest = 1e-300;
    const double limit = c->options->let_in;
    for (int j = 0; j < c->joints; j++) {
        if (c->watch->drift_started != 0.0) way = fmax(way, fabs(c->positions[j] - c->drift_last[j]));
        c->drift_last[j] = c->positions[j];
    }
    c->watch->drift_started = 1.0;
    for (int i = 0; i < 6 * c->arms; i++) fastest = fmax(fastest, fabs(apart[i] - c->slow_drift[i]));
    c->minding->way_done = way;
    const double share = fmin((LARGEST_SLOPE * way + GROWS * dt) / fastest, 1.0);
    for (int i = 0; i < 6 * c->arms; i++) {
        c->slow_drift[i] = clamp(c->slow_drift[i] + share * (apart[i] - c->slow_drift[i]), -limit, limit);
        out[i] = apart[i] - c->slow_drift[i];
    }
}

/* -- out of step --------------------------------------------------------------------------------------------------- */

/* Count the samples in a row in which an arm is as far from the others as a fault needs. One that the arm farthest from
 * its command has lost says nothing. */
static void count_far(Core *c, const double *away, const double *apart, const double *out_of_step, double *unfiltered) {
    int farthest = 0;
    double most = -1.0;
    for (int k = 0; k < c->arms; k++) {
        double own = square6(away + 6 * k);
        if (own > most) most = own, farthest = k;
    }
    if (has_lost(c, farthest)) return;
    from_others(c, away, unfiltered);
    for (int i = 0; i < 6 * c->arms; i++) unfiltered[i] -= apart[i] - out_of_step[i];
    const double limit = c->options->fault_from;
    const int far = largest_square6(c, unfiltered) >= limit * limit;
    c->watch->far_samples = far ? c->watch->far_samples + 1.0 : 0.0;
}

static double own_distance(const Core *c, int k) { return sqrt(square6(c->deviation + 6 * k)); }

static int as_far(const double *out_of_step, int k, double largest) {
    return sqrt(square6(out_of_step + 6 * k)) >= 0.99 * largest;
}

/* Of arms equally far from the others, as two arms always are, the one that is not where it should be; of several, the
 * one that was named last, or the first. */
static int most_out_of_step(const Core *c, const double *out_of_step, double largest) {
    const int last = (int)c->watch->watch_arm;
    double most = -1.0;
    int arm = -1;
    for (int k = 0; k < c->arms; k++)
        if (as_far(out_of_step, k, largest)) most = fmax(most, own_distance(c, k));
    for (int k = c->arms - 1; k >= 0; k--)
        if (as_far(out_of_step, k, largest) && own_distance(c, k) > most - EQUALLY_FAR && (arm < 0 || arm != last))
            arm = k;
    return arm < 0 ? 0 : arm;
}

/* Deviation of each arm from the mean of the others that slows or stops the object. */
static void watch_distances(Core *c, const double *q, const double *away_given, double dt, int rigid, Seen *seen) {
    const Options *o = c->options;
    const int count = 6 * c->arms;
    double *away = c->scratch, *apart = away + count, *out_of_step = apart + count, *unfiltered = out_of_step + count;
    to_grasps(c, away_given, away);
    keep_where_lost(c, q, away);
    const double fresh = dt / (o->filter_time + dt);
    for (int i = 0; i < count; i++) c->deviation[i] += fresh * (away[i] - c->deviation[i]);
    const double share = sqrt(dt / (2.0 * o->filter_time + dt)); /* of the noise that passes the filter */
    const double noise = share * noise_seen(c->arms, &c->watch->samples, c->away, c->away_step, c->noise, away, dt);
    from_others(c, c->deviation, apart);
    if (o->let_in > 0.0 && rigid)
        follow_drift(c, apart, dt, out_of_step);
    else if (o->let_in > 0.0)
        without_drift(c, apart, noise, dt, out_of_step);
    else
        memcpy(out_of_step, apart, sizeof(double) * (size_t)count);
    count_far(c, away, apart, out_of_step, unfiltered);
    const double largest = sqrt(largest_square6(c, out_of_step));
    const double worst = largest - o->noise_margin * noise;
    c->watch->lag_noise = o->noise_margin * noise / sqrt((double)c->arms) + fmax(worst, 0.0); /* see watch_lag() */
    if (worst <= o->slow_from || c->watch->samples < FEW_SAMPLES) return;
    const int arm = most_out_of_step(c, out_of_step, largest);
    hold_for(seen, OUT_OF_STEP_BY, arm, sqrt(square6(out_of_step + 6 * arm)), 0.0);
    seen->fault = worst >= o->fault_from && c->watch->far_samples >= FAULT_SAMPLES;
    if (!(worst < o->hold_from)) return;
    seen->hold = 0;
    seen->cap = (o->hold_from - worst) / (o->hold_from - o->slow_from);
}

/* -- stalls -------------------------------------------------------------------------------------------------------- */

/* The sample so many samples before the last one, or the oldest. */
static const double *sample_before(const Core *c, int samples) {
    const int count = (int)c->watch->past_count, last = (int)c->watch->past_head + c->past - 1;
    return c->history + 2 * (size_t)c->joints * (size_t)((last - (samples < count ? samples : count - 1)) % c->past);
}

/* Keep this sample in the ring. */
static void remember(Core *c, const double *positions) {
    Watch *w = c->watch;
    const size_t joints = (size_t)c->joints;
    double *slot = c->history + 2 * joints * (size_t)w->past_head;
    memcpy(slot, positions, sizeof(double) * joints);
    memcpy(slot + joints, c->positions, sizeof(double) * joints);
    w->past_head = w->past_head + 1.0 < c->past ? w->past_head + 1.0 : 0.0;
    w->past_count = fmin(w->past_count + 1.0, c->past);
}

/* The least of the largest motions that the joints of arm k were commanded to make in as many samples, now or up to LAG ago: one
 * of them is what a late arm should have made. */
static double least_told(const Core *c, int k, double told) {
    const int start = (int)c->arm_start[k], end = start + (int)c->arm_size[k], samples = (int)c->options->stall_samples;
    const int late = (int)c->watch->past_count - 1 - samples;
    for (int i = 1; i <= late; i++) {
        const double *from = sample_before(c, samples + i) + c->joints, *to = sample_before(c, i) + c->joints;
        double most = 0.0;
        for (int j = start; j < end; j++) most = fmax(most, fabs(to[j] - from[j]));
        told = fmin(told, most);
    }
    return told;
}

/* Largest motions of the joints of arm k since an older sample, as commanded and measured, and what lies between. */
static void moves_of(const Core *c, int k, const double *positions, const double *before, double *told, double *moved,
                     double *gap) {
    const int start = (int)c->arm_start[k], end = start + (int)c->arm_size[k];
    double most[3] = {};
    for (int j = start; j < end; j++) {
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
        c->widest[k] = fmax(c->widest[k], gap[k]);
        if (gap[k] < fmax(CAUGHT_UP, CAUGHT_UP_SHARE * c->widest[k])) c->stalled[k] = 0.0;
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

/* Of arms in rigid grips that mind forces, their wrenches say more: here, only whether all have stopped. */
static void watch_stall(Core *c, const double *positions, double dt, int rigid, Seen *seen) {
    double *told = c->scratch, *moved = told + c->arms, *gap = moved + c->arms;
    remember(c, positions);
    const double *before = sample_before(c, (int)c->options->stall_samples);
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

/* x of A x = b for a symmetric A (6, 6) of which the lower triangle is read and overwritten by its factors L D Lᵀ; b
 * becomes x. Without a pivot it is not finite. */
static void solve_symmetric6(double *A, double *b) {
    for (int j = 0; j < 6; j++) {
        for (int i = j + 1; i < 6; i++) {
            const double factor = A[6 * i + j] / A[7 * j];
            for (int m = j + 1; m <= i; m++) A[6 * i + m] -= factor * A[6 * m + j];
            b[i] -= factor * b[j];
        }
    }
    for (int i = 5; i >= 0; i--) {
        for (int m = i + 1; m < 6; m++) b[i] -= A[6 * m + i] * b[m]; /* columns still carry D */
        b[i] /= A[7 * i];
    }
}

/* Compliance C_k of an arm's servos at the object, and how its deflection bends it. */
static void comply(const Core *c, int k, const double *jacobian, double *C, double *bent) {
    const int start = (int)c->arm_start[k], end = start + (int)c->arm_size[k];
    memset(C, 0, 36 * sizeof(double));
    memset(bent, 0, 6 * sizeof(double));
    for (int j = start; j < end; j++) {
        const double *row = jacobian + 6 * j;
        for (int i = 0; i < 6; i++) {
            const double soft = c->softness[j] * row[i];
            for (int m = 0; m < 6; m++) C[6 * i + m] += soft * row[m];
            bent[i] += c->deflection[j] * row[i];
        }
    }
}

/* Filter the deflection of the servos; find the commanded velocity. Returns whether all joints rest. */
static int deflect(Core *c, const double *positions, double dt, double *velocity) {
    const Options *o = c->options;
    const double fresh = dt / (o->filter_time + dt), known = c->watch->has_commanded;
    double fastest = 0.0;
    for (int k = 0; k < c->arms; k++) {
        const int start = (int)c->arm_start[k], end = start + (int)c->arm_size[k];
        for (int j = start; j < end; j++) {
            velocity[j] = known != 0.0 ? (c->positions[j] - c->commanded[j]) / dt : 0.0;
            const double off = c->positions[j] - positions[j] - o->servo_delay * velocity[j];
            c->deflection[j] += fresh * (off - c->deflection[j]);
            fastest = fabs(velocity[j]) > fastest ? fabs(velocity[j]) : fastest;
        }
    }
    memcpy(c->commanded, c->positions, sizeof(double) * (size_t)c->joints);
    c->watch->has_commanded = 1.0;
    return fastest <= AT_REST;
}

/* Cosine between the way back that a wrench asks of arm k and its last motion. */
static double straightness(const Core *c, int k, const double *jacobian, const double *back) {
    const int start = (int)c->arm_start[k], end = start + (int)c->arm_size[k];
    double way[6] = {0}, scaled[6];
    for (int j = start; j < end; j++)
        for (int i = 0; i < 6; i++) way[i] += c->way[j] * jacobian[6 * j + i];
    for (int i = 0; i < 6; i++) {
        const double scale = i < 3 ? 1.0 : TURN_LENGTH;
        way[i] *= scale;
        scaled[i] = back[i] * scale;
    }
    const double size = sqrt(square6(scaled)) * sqrt(square6(way));
    return (dot3(scaled, way) + dot3(scaled + 3, way + 3)) / fmax(size, 1e-300);
}

/* At rest, the arm that the total wrench puts straight back along its way does not follow its command. */
static void find_behind(Core *c, const double *jacobian, const double *C, const double *wrenches, double largest) {
    Watch *w = c->watch;
    double total[6] = {0}, straightest = STRAIGHT_BACK;
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) total[i] += wrenches[6 * k + i];
    if (!(sqrt(dot3(total, total)) > UNBALANCED * largest)) return;
    for (int k = 0; k < c->arms; k++) {
        double back[6] = {};
        for (int i = 0; i < 6; i++)
            for (int m = 0; m < 6; m++) back[i] += C[36 * k + 6 * i + m] * total[m];
        const double straight = straightness(c, k, jacobian, back);
        if (!(straight > straightest)) continue;
        straightest = straight;
        w->behind = k;
        w->gap = sqrt(dot3(back, back));
        double others[3];
        for (int i = 0; i < 3; i++) others[i] = total[i] - wrenches[6 * k + i];
        w->pull = sqrt(dot3(others, others));
    }
}

/* Jacobians about the object as arm 0 carries it at the measured positions. */
static void linearise_measured(const Core *c, const double *positions, double *carried, double *jacobian) {
    const double *near = c->carried + 9; /* any point would do: nearby ones lose no digits */
    carry_and_linearise(c, positions, near, carried, jacobian);
    const double shift[3] = {carried[9] - near[0], carried[10] - near[1], carried[11] - near[2]};
    for (int j = 0; j < c->joints; j++) {
        double *row = jacobian + 6 * j, turned[3];
        cross(row + 3, shift, turned);
        for (int i = 0; i < 3; i++) row[i] += turned[i];
    }
}

/* Read the force at each grasp, and the arm that lags. Returns the arm with the largest force. */
static int read_forces(Core *c, const double *positions, double dt) {
    const int n = c->arms, nv = c->joints;
    double *carried = c->scratch, *C = carried + 12 * n, *wrenches = C + 36 * n;
    Watch *w = c->watch;
    double *jacobian = wrenches + 6 * n, *velocity = jacobian + 6 * nv;
    const int rests = deflect(c, positions, dt, velocity);
    linearise_measured(c, positions, carried, jacobian);
    int most = 0;
    for (int k = 0; k < n; k++) {
        double factored[36];
        comply(c, k, jacobian, C + 36 * k, wrenches + 6 * k);
        memcpy(factored, C + 36 * k, sizeof factored);
        for (int i = 0; i < 6; i++) factored[7 * i] += STRUCTURE;
        solve_symmetric6(factored, wrenches + 6 * k);
        c->forces[k] = sqrt(dot3(wrenches + 6 * k, wrenches + 6 * k));
        if (larger(c->forces[most], c->forces[k]) != c->forces[most]) most = k;
    }
    w->behind = -1.0;
    if (!rests) {
        for (int k = 0; k < n; k++) {
            const int start = (int)c->arm_start[k];
            memcpy(c->way + start, velocity + start, sizeof(double) * (size_t)c->arm_size[k]);
        }
        w->rest = 0.0;
        return most;
    }
    w->rest += dt;
    if (w->rest > SERVOS_SETTLED) find_behind(c, jacobian, C, wrenches, c->forces[most]);
    return most;
}

/* What the force of arm k comes to soon at its pace, from LET_GO of the limit on. */
static double force_soon(Core *c, int k, double dt) {
    c->slow_forces[k] += dt / (PACE_TIME + dt) * (c->forces[k] - c->slow_forces[k]);
    if (!(c->forces[k] >= LET_GO * c->options->force_limit)) return c->forces[k];
    return c->forces[k] + SOON / PACE_TIME * fmax(c->forces[k] - c->slow_forces[k], 0.0);
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
    w->pressed = !(soon < (w->pressed != 0.0 ? LET_GO * limit : limit));
    if (w->pressed == 0.0) return;
    if (w->behind < 0.0)
        hold_for(seen, force < limit && soon >= limit ? FORCE_GROWS : FORCE, most, force, soon);
    else
        hold_for(seen, HANGS_BEHIND, (int)w->behind, w->gap, w->pull);
}

/* Of arms that mind forces; see residual.cpp. */
static void add_shift(const Core *c, double *away);
static void watch_servos(Core *c, const double *away, double dt, Seen *seen);
static void watch_lag(Core *c, double dt, Seen *seen);

/* -- one sample ---------------------------------------------------------------------------------------------------- */

static int all_finite(const Core *c, const double *positions, const double *away, double dt) {
    int finite = dt > 0.0 && dt <= DBL_MAX;
    for (int j = 0; j < c->joints; j++) finite &= fabs(positions[j] - c->positions[j]) <= DBL_MAX;
    for (int i = 0; i < 6 * c->arms; i++) finite &= fabs(away[i]) <= DBL_MAX;
    return finite;
}

/* A slowed object is let go at such a pace that it takes a while from rest. */
static void recover(Core *c, double dt, Seen *seen) {
    Watch *w = c->watch;
    const double allowed = w->watch_rate + dt / c->options->recovery_time;
    if (allowed < seen->cap) {
        seen->cap = allowed;
        if (seen->reason == NO_REASON) seen->reason = WAS_OUT_OF_STEP, seen->arm = (int)w->watch_arm;
    }
    w->watch_rate = seen->cap;
    w->watch_arm = seen->arm;
}

/* Slow arms that are out of step down gently: a jolt would be a force of its own. */
static void fall_gently(const Core *c, double dt, Seen *seen) {
    const double least = c->watch->watch_rate - dt / CAP_FALLS;
    if (seen->fault || !(least > seen->cap)) return;
    seen->cap = least, seen->hold = 0;
}

static void watch_sample(Core *c, const double *positions, const double *q, const double *away, double dt) {
    const Options *o = c->options;
    const int minds = c->arms > 1 && c->minding && c->minding->rigid != 0.0;
    Proposal *out = c->proposal;
    double *moved = c->measured_moved;
    Seen seen;
    if (!all_finite(c, positions, away, dt)) {
        hold_for(&seen, NOT_FINITE, -1, 0.0, 0.0);
    } else {
        memcpy(moved, away, sizeof(double) * 6 * (size_t)c->arms);
        if (minds) add_shift(c, moved);
        if (c->arms > 1 && o->slow_from >= 0.0) watch_distances(c, q, moved, dt, minds, &seen);
        if (minds) fall_gently(c, dt, &seen);
        if (minds && o->slow_from >= 0.0) watch_servos(c, away, dt, &seen);
        if (o->stall_samples > 0.0) watch_stall(c, positions, dt, minds, &seen);
        if (o->watches_force != 0.0) watch_forces(c, positions, dt, &seen);
        if (c->arms > 1 && !c->minding && o->watches_force == 0.0 && o->slow_from >= 0.0) watch_lag(c, dt, &seen);
        if (o->recovery_time > 0.0) recover(c, dt, &seen);
        if (c->minding && c->minding->touches != 0.0 && !seen.fault) hold_for(&seen, TOUCHING, -1, 0.0, 0.0); /* at once */
    }
    if (out->faults != 0.0 || !(seen.cap < out->watch_cap || seen.fault)) return; /* a fault stays as it is */
    out->watch_cap = seen.cap;
    out->hold = seen.hold, out->faults = seen.fault;
    out->reason = seen.reason, out->reason_arm = seen.arm;
    out->reason_a = seen.a, out->reason_b = seen.b;
}

static void watch_reset(Core *c) {
    const size_t arms = sizeof(double) * (size_t)c->arms, joints = sizeof(double) * (size_t)c->joints;
    double *of_arms[] = {c->noise, c->stalled, c->widest, c->lost, c->forces, c->slow_forces};
    double *of_distances[] = {c->deviation, c->away, c->away_step, c->slow_drift, c->lag, c->apart};
    *c->watch = Watch{};
    c->watch->watch_rate = 1.0;
    c->watch->watch_arm = c->watch->behind = -1.0;
    c->watch->var_lag = LAG * LAG;
    for (size_t i = 0; i < sizeof of_arms / sizeof *of_arms; i++) memset(of_arms[i], 0, arms);
    for (size_t i = 0; i < sizeof of_distances / sizeof *of_distances; i++) memset(of_distances[i], 0, 6 * arms);
    memset(c->told_velocity, 0, joints);
    memset(c->lag_base, 0, 6 * sizeof(double));
    memset(c->lag_told, 0, 6 * sizeof(double));
    memset(c->lag_way, 0, 6 * sizeof(double));
    memset(c->deflection, 0, joints);
    memset(c->way, 0, joints);
}
