/* The path ahead of the object's clock: where limits and singularities bind, and how fast the object may go. The
 * definition, with the formulae, is PathPreview in coopqp/planning/preview.py.
 *
 * Knots lie in a ring, numbered from the one at or before the clock; `place` is where in the ring. COUNT of them are
 * known. Behind these lie tentative ones: WAY knots of a way past a singularity, then the knot that is being tried. So
 * all that a pause has to keep is in the state, and a copy of the state goes on as the original would. */

#include "functions.h"

/* What one Newton step makes of the knot that is tried. CANNOT_SAY: a user's path, or a further constraint, fails. */
typedef enum { PENDING, REJECTED, FOUND, CANNOT_SAY } Trial;

/* -- memory -------------------------------------------------------------------------------------------------------- */

typedef struct {
    double *carried, *errors, *w, *jacobian, *step, *wish, *after;
} Sketch;

static Sketch sketch_of(const Core *c) {
    const int n = c->arms, nv = c->joints;
    double *carried = c->sketch, *errors = carried + 12 * n, *w = errors + 6 * n, *jacobian = w + 6 * n;
    double *step = jacobian + 6 * nv;
    return (Sketch){carried, errors, w, jacobian, step, step + nv, step + 2 * nv};
}

static int count_ahead(const Core *c, int what) { return (int)c->ahead[what]; }

static int place_of(const Core *c, int i) { return (count_ahead(c, HEAD) + i) % MOST_KNOTS; }

static double *knot_in(const Core *c, int place) { return c->knots + (size_t)place * N_KNOT; }

static double *knot(const Core *c, int i) { return knot_in(c, place_of(c, i)); }

/* Vectors of knot i: knot_positions, knot_slope or knot_curvature. */
static double *vector_of(const Core *c, double *vectors, int i) {
    return vectors + (size_t)place_of(c, i) * (size_t)c->joints;
}

static void copy_knot(Core *c, int from, int to) {
    const size_t bytes = sizeof(double) * (size_t)c->joints;
    if (from == to) return;
    memcpy(knot(c, to), knot(c, from), sizeof(double) * N_KNOT);
    memcpy(vector_of(c, c->knot_positions, to), vector_of(c, c->knot_positions, from), bytes);
    memcpy(vector_of(c, c->knot_slope, to), vector_of(c, c->knot_slope, from), bytes);
    memcpy(vector_of(c, c->knot_curvature, to), vector_of(c, c->knot_curvature, from), bytes);
}

/* K_KIND, K_ARM, K_JOINT of a knot, or CAP_KIND, CAP_ARM, CAP_JOINT. */
static void name_cause(double *cause, int kind, int arm, int joint) {
    cause[0] = kind;
    cause[1] = arm;
    cause[2] = joint;
}

static int arm_of(const Core *c, int joint) {
    int k = 0;
    while (k + 1 < c->arms && c->arm_start[k + 1] <= joint) k++;
    return k;
}

static double largest_size(const double *x, int n) {
    double largest = 0.0;
    for (int j = 0; j < n; j++) largest = maximum(largest, fabs(x[j]));
    return largest;
}

/* -- sharing the accelerations: coopqp/planning/sharing.py defines it ----------------------------------------------- */

/* Lines α u + β z ≤ γ, as bounds (γ − β z)/α of u: upper ones from the front of the tables, lower ones from their back.
 * `high` and `low` are the pair that makes z, −1 where none does; `still` is the row of a bound of z alone. */
typedef struct {
    double *share, *slope, *row;
    int ups, downs, room, still, high, low;
    double square;
} Lines;

/* A bound of z alone: β z ≤ γ. */
static void add_still(Lines *l, double beta, double gamma, int row) {
    if (beta > 0.0 && gamma < l->square * beta) l->square = gamma / beta, l->still = row;
}

static void add_line(Lines *l, double alpha, double beta, double gamma, int row) {
    if (fabs(alpha) <= STILL_SLOPE) {
        add_still(l, beta, gamma, row);
        return;
    }
    const int at = alpha > 0.0 ? l->ups++ : l->room - ++l->downs;
    const double per = 1.0 / alpha;
    l->share[at] = gamma * per;
    l->slope[at] = beta * per;
    l->row[at] = row;
}

/* |α u + β z| + e z ≤ γ for both β: two lines, as z is not negative. */
static void add_pair(Lines *l, double alpha, double beta, double other, double e, double gamma, int row) {
    const double size = fabs(alpha), one = alpha < 0.0 ? -beta : beta, two = alpha < 0.0 ? -other : other;
    if (size <= STILL_SLOPE) {
        add_still(l, e + maximum(fabs(beta), fabs(other)), gamma, row);
        return;
    }
    const double per = 1.0 / size;
    const int up = l->ups++, down = l->room - ++l->downs;
    l->share[up] = gamma * per;
    l->slope[up] = (maximum(one, two) + e) * per;
    l->share[down] = -gamma * per;
    l->slope[down] = (minimum(one, two) - e) * per;
    l->row[up] = l->row[down] = row;
}

static Lines lines_of(const Core *c, double cap) {
    const int room = 4 * c->joints + 4;
    return (Lines){c->lines, c->lines + room, c->lines + 2 * room, 0, 0, room, -1, -1, -1, cap};
}

/* Largest z that some u allows: where the largest lower bound of u meets the least upper one, by Newton's method from
 * above. */
static double largest_z(Lines *l) {
    double z = l->square;
    for (int pivot = 0; pivot < MOST_PIVOTS; pivot++) {
        int i = 0, j = l->room - l->downs;
        double high = INFINITY, low = -INFINITY;
        for (int k = 0; k < l->ups; k++) {
            const double bound = l->share[k] - l->slope[k] * z;
            if (bound < high) high = bound, i = k;
        }
        for (int k = l->room - 1; k >= l->room - l->downs; k--) {
            const double bound = l->share[k] - l->slope[k] * z;
            if (bound > low) low = bound, j = k;
        }
        const double over = low - high;
        if (!(over > CROSSED * (1.0 + fabs(low))) || z <= 0.0) break;
        z = maximum(z - over / (l->slope[i] - l->slope[j]), 0.0);
        l->high = i, l->low = j;
    }
    return z;
}

/* The largest z up to which the lower bound that made `z` stays between the other lines, but for upper bound `moves`. */
static double largest_along(const Lines *l, double z, int moves) {
    const double share = l->share[l->low], slope = l->slope[l->low];
    double most = l->square;
    for (int k = 0; k < l->ups; k++) {
        const double leaves = l->slope[k] - slope, room = l->share[k] - share;
        if (k != moves && leaves > 0.0 && room < most * leaves) most = room / leaves;
    }
    for (int k = l->room - l->downs; k < l->room; k++) {
        const double leaves = slope - l->slope[k], room = share - l->share[k];
        if (leaves > 0.0 && room < most * leaves) most = room / leaves;
    }
    return maximum(most, z);
}

/* Largest z ≤ cap that some |u| ≤ SLOPE_CAP allows at knot i alone. */
static double largest_alone(const Core *c, int i) {
    const double *slope = vector_of(c, c->knot_slope, i), *bend = vector_of(c, c->knot_curvature, i);
    Lines l = lines_of(c, knot(c, i)[K_CAP]);
    for (int j = 0; j < c->joints; j++) add_pair(&l, slope[j], bend[j], bend[j], 0.0, c->plan_acceleration[j], j);
    add_pair(&l, 1.0, 0.0, 0.0, 0.0, c->options[SLOPE_CAP], c->joints);
    return largest_z(&l);
}

/* Whether q″ has changed by a small share of the accelerations between the intervals before two knots. */
static int bends_slowly(const Core *c, int last, int made) {
    const double *k = knot(c, last);
    if (k[K_SPAN] == 0.0 || k[K_CORNER] != 0.0) return 1;
    const double *bend = vector_of(c, c->knot_curvature, made), *before = vector_of(c, c->knot_curvature, last);
    double change = 0.0;
    for (int j = 0; j < c->joints; j++) change = maximum(change, fabs(bend[j] - before[j]) / c->plan_acceleration[j]);
    return change <= BEND_CHANGE || change * largest_alone(c, made) <= BEND_CHANGE;
}

/* Largest z at knot i from which that at the next knot can be in [0, K there], and how it follows K there; the joint
 * whose acceleration makes it, or helps to, or −1. */
static int find_share(Core *c, int i) {
    double *here = knot(c, i);
    const double *ahead = knot(c, i + 1);
    const double *slope = vector_of(c, c->knot_slope, i), *chord = vector_of(c, c->knot_curvature, i + 1);
    const double *before = vector_of(c, c->knot_curvature, i), *after = chord, *a = c->plan_acceleration;
    const double span = ahead[K_SPAN], two = 2.0 * span, most = c->options[SLOPE_CAP];
    double span_before = 0.0, span_after = 0.0;
    Lines l = lines_of(c, here[K_CAP]);
    if (here[K_SPAN] > 0.0 && here[K_CORNER] == 0.0) span_before = here[K_SPAN];
    if (i + 2 < count_ahead(c, COUNT) && ahead[K_CORNER] == 0.0) {
        after = vector_of(c, c->knot_curvature, i + 2);
        span_after = knot(c, i + 2)[K_SPAN];
    }
    for (int j = 0; j < c->joints; j++) {
        const double C = chord[j], arrival = slope[j] + C * span;
        const double b = span_before > 0.0 ? (before[j] * span + C * span_before) / (span_before + span) : C;
        const double d = span_after > 0.0 ? (C * span_after + after[j] * span) / (span + span_after) : C;
        const double doubt = c->options[DOUBT] * (fabs(b - C) + fabs(d - C));
        const double high = maximum(d, C), low = minimum(d, C);
        add_pair(&l, slope[j], b, C, doubt, a[j], j);
        add_line(&l, two * (doubt + high) + arrival, doubt + high, a[j], j);
        add_line(&l, two * (doubt - low) - arrival, doubt - low, a[j], j);
    }
    add_line(&l, 1.0, 0.0, minimum(most, minimum(here[K_RISE], ahead[K_RISE])), c->joints);
    add_line(&l, -1.0, 0.0, minimum(most, minimum(here[K_FALL], ahead[K_FALL])), c->joints);
    add_line(&l, -two, -1.0, 0.0, c->joints);
    add_line(&l, two, 1.0, ahead[K_SQUARE], c->joints + 1);
    const double z = largest_z(&l);
    here[K_SQUARE] = z;
    here[K_GAIN] = 0.0;
    here[K_UNTIL] = INFINITY;
    const int high = l.high < 0 ? l.still : (int)l.row[l.high], low = l.low < 0 ? -1 : (int)l.row[l.low];
    if (high == c->joints + 1) {
        const double share = l.share[l.low], falls = l.slope[l.low], end = largest_along(&l, z, l.high);
        here[K_GAIN] = 1.0 / (1.0 - two * falls);
        here[K_UNTIL] = end + two * (share - falls * end);
    }
    return high >= 0 && high < c->joints ? high : low >= 0 && low < c->joints ? low : -1;
}

/* K at knot i from that at the next one, and what makes it; 1 if that is K ahead. K only rises from one pass to the next,
 * and follows K ahead along a line from K_SINCE, where it was K_FOUND, to K_UNTIL. */
static int share_at(Core *c, int i) {
    double *here = knot(c, i);
    const double *ahead = knot(c, i + 1), then = ahead[K_SQUARE];
    int joint = -1;
    if (here[K_SINCE] <= then && then <= here[K_UNTIL] && then < 1.0) {
        here[K_SQUARE] = here[K_FOUND] + here[K_GAIN] * (then - here[K_SINCE]);
    } else {
        if (ahead[K_SPAN] == 0.0) { /* the same knot again */
            here[K_SQUARE] = minimum(then, here[K_CAP]);
            here[K_GAIN] = then < here[K_CAP];
            here[K_UNTIL] = here[K_GAIN] != 0.0 ? here[K_CAP] : INFINITY;
        } else {
            joint = find_share(c, i);
        }
        here[K_FOUND] = here[K_SQUARE];
        here[K_SINCE] = then;
    }
    const int by_ahead = here[K_GAIN] > 0.0;
    if (by_ahead && (then < 1.0 || joint < 0))
        memcpy(here + K_CAUSE_KIND, ahead + K_CAUSE_KIND, 4 * sizeof(double));
    else if (joint >= 0)
        name_cause(here + K_CAUSE_KIND, ACCELERATION, arm_of(c, joint), joint), here[K_STOPS] = 0.0;
    else
        memcpy(here + K_CAUSE_KIND, here + K_KIND, 3 * sizeof(double)), here[K_STOPS] = here[K_CAP] == 0.0;
    return by_ahead;
}

/* Find K from the last knot back to the first one whose K is known for good. Where more knots may come the object rests
 * at the last knot but one: q″ is not known at the last. */
static void look_back(Core *c) {
    const int count = count_ahead(c, COUNT), complete = c->ahead[COMPLETE] != 0.0, end = count - (complete ? 1 : 2);
    int settled = complete ? count : 0;
    c->ahead[FRESH] = 0.0;
    if (end < 0) return;
    if (complete) {
        double *last = knot(c, end);
        last[K_SQUARE] = last[K_CAP];
        memcpy(last + K_CAUSE_KIND, last + K_KIND, 3 * sizeof(double));
        last[K_STOPS] = last[K_CAP] == 0.0;
    }
    for (int i = end - 1; i >= count_ahead(c, KNOWN); i--)
        if (!share_at(c, i) && !settled) settled = i + 1;
    c->ahead[KNOWN] = maximum(c->ahead[KNOWN], settled);
}

/* -- the chain at one clock ---------------------------------------------------------------------------------------- */

/* w_k = −R e_k */
static void twists_back(const Core *c, const double *R, const double *errors, double *w) {
    for (int i = 0; i < 2 * c->arms; i++) {
        const double e[3] = {-errors[3 * i], -errors[3 * i + 1], -errors[3 * i + 2]};
        rotate(R, e, w + 3 * i);
    }
}

/* Self-motion of arm k that moves its joint `j`, (n,); 0 if the arm is singular. */
static int self_motion(const Core *c, int k, const double *jacobian, int j, double *way) {
    static const double still[MOST_JOINTS];
    const int start = (int)c->arm_start[k], n = (int)c->arm_size[k];
    double push[MOST_JOINTS] = {0}, other[MOST_JOINTS];
    const double *JT = jacobian + 6 * start, *scale = c->scale + start;
    push[j] = 1.0;
    return arm_velocities(JT, scale, n, still, still, push, still, way, other) ||
           far_velocities(JT, scale, n, still, still, push, still, way, other);
}

/* Lead the joints of redundant arm k away from their limits by its self-motion: coopqp/planning/redundancy.py. */
static void lead_away(const Core *c, int k, const double *jacobian, const double *positions, double *slope) {
    const int start = (int)c->arm_start[k], n = (int)c->arm_size[k];
    double up[MOST_JOINTS], down[MOST_JOINTS], beyond[MOST_JOINTS], way[MOST_JOINTS], largest = 0.0;
    for (int j = 0; j < n; j++) largest = maximum(largest, fabs(slope[start + j]) / c->scale[start + j]);
    largest /= TURNING_WAY;
    if (!(largest > 0.0)) return;
    for (int j = 0; j < n; j++) {
        const double x = positions[start + j], scale = c->scale[start + j], own = slope[start + j];
        up[j] = largest * scale * (c->high[start + j] - LIMIT_MARGIN - x);
        down[j] = largest * scale * (c->low[start + j] + LIMIT_MARGIN - x);
        beyond[j] = maximum(own - up[j], down[j] - own) / scale;
    }
    int worst = 0, found = 0;
    for (int tries = 0; tries < n && !found; tries++) {
        worst = 0;
        for (int j = 1; j < n; j++)
            if (beyond[j] > beyond[worst]) worst = j;
        if (!(beyond[worst] > 0.0)) return;
        found = self_motion(c, k, jacobian, worst, way) && way[worst] > LEADS;
        beyond[worst] = -INFINITY;
    }
    if (!found) return;
    double low = -INFINITY, high = INFINITY;
    for (int j = 0; j < n; j++) {
        if (!(fabs(way[j]) > LEADS * way[worst])) continue;
        const double own = slope[start + j], a = (down[j] - own) / way[j], b = (up[j] - own) / way[j];
        low = maximum(low, minimum(a, b)), high = minimum(high, maximum(a, b));
    }
    const double z = low > high ? 0.5 * (low + high) : minimum(maximum(0.0, low), high);
    for (int j = 0; j < n; j++) slope[start + j] += z * way[j];
}

/* Newton's step from `positions` to the pose at `clock`, and q′ there; where the twist jumps, that before it. */
static Trial newton_step(Core *c, double clock, double before, const double *positions, double *step, double *slope) {
    const Sketch s = sketch_of(c);
    double R[9], p[3], twist[6], along[6], size = 0.0;
    if (!path_pose(c, clock, R, p) || !path_twist(c, maximum(minimum(clock, c->duration) - before, 0.0), twist))
        return CANNOT_SAY;
    carry_and_linearise(c, positions, p, s.carried, s.jacobian);
    if (!errors_at(c, s.carried, R, p, s.errors)) return REJECTED;
    twists_back(c, R, s.errors, s.w);
    rotate(R, twist, along);
    rotate(R, twist + 3, along + 3);
    if (c->redundant) posture_velocity(c, positions, s.wish);
    if (!two_velocities(c, s.jacobian, s.w, along, NULL, c->redundant ? s.wish : NULL, step, slope)) return REJECTED;
    for (int k = 0; c->redundant && k < c->arms; k++)
        if (c->arm_size[k] > 6.0) lead_away(c, k, s.jacobian, positions, slope);
    for (int j = 0; j < c->joints; j++) size += step[j] * step[j] + slope[j] * slope[j];
    return size < INFINITY ? FOUND : REJECTED;
}

/* Bounds of knot i from its positions and slope, and the slope of the knot before (−1 for none); 0 if they overflow. */
static int bound_by_limits(Core *c, int before, int i, double clock, double span) {
    const double *slope = vector_of(c, c->knot_slope, i), *x = vector_of(c, c->knot_positions, i), *o = c->options;
    const double *then = before < 0 ? slope : vector_of(c, c->knot_slope, before);
    double *k = knot(c, i), *curvature = vector_of(c, c->knot_curvature, i);
    double fastest = 0.0, change = -INFINITY, by_speed = 0.0, by_bend = 0.0;
    int j_speed = 0, j_bend = 0, inside = 1;
    for (int j = 0; j < c->joints; j++) {
        curvature[j] = (slope[j] - then[j]) / span;
        const double bend = fabs(curvature[j]), speed = fabs(slope[j]);
        /* How often the joint's limit is used up at full rate: z may be 1 over the square, or over the curvature's. */
        const double use_speed = speed * (1.0 / c->plan_speed[j]);
        const double use_bend = bend * (1.0 / (o[CURVATURE_SHARE] * c->plan_acceleration[j]));
        fastest = maximum(fastest, fabs(slope[j]));
        change = maximum(change, bend * span - c->slope_change[j]);
        if (use_speed > by_speed) by_speed = use_speed, j_speed = j;
        if (use_bend > by_bend) by_bend = use_bend, j_bend = j;
        inside &= x[j] <= c->high[j] && x[j] >= c->low[j];
    }
    /* Without acceleration limits the step itself finds the cap by speed; it changes slowly under that by curvature. */
    const int capped = o[CAPS_SPEED] != 0.0;
    const double square = by_speed * by_speed, cap = 1.0 / maximum(capped ? square : by_bend, 1.0);
    memset(k, 0, sizeof(double) * N_KNOT);
    k[K_CLOCK] = clock;
    k[K_SPAN] = before < 0 ? 0.0 : span;
    k[K_CAP] = cap;
    k[K_UNCAPPED] = 1.0 / maximum(maximum(square, by_bend), 1.0);
    k[K_FASTEST] = fastest;
    k[K_CHANGE] = change;
    k[K_INSIDE] = inside;
    k[K_FALL] = k[K_RISE] = k[K_SINCE] = INFINITY;
    name_cause(k + K_KIND, NONE, -1, -1);
    name_cause(k + K_CAUSE_KIND, NONE, -1, -1);
    const int j = capped ? j_speed : j_bend;
    if (cap < 1.0) name_cause(k + K_KIND, capped ? VELOCITY : ACCELERATION, arm_of(c, j), j);
    return cap > 0.0;
}

/* Put a knot under the further constraints; rejected if one allows no rate there: its number and the clock are kept. */
static Trial constrain(Core *c, int made) {
    double *k = knot(c, made);
    if (!c->bound_knot || c->bound_knot(c, place_of(c, made))) return FOUND;
    if (isnan(k[K_CAP])) return CANNOT_SAY;
    c->ahead[BEYOND] = 1.0 + k[K_JOINT];
    c->ahead[BEYOND_AT] = k[K_CLOCK];
    return REJECTED;
}

/* Half of what is left between a knot and where a constraint allows no rate, infinite where none is known. */
static double half_way(const Core *c, const double *last) {
    return c->ahead[BEYOND] > 0.0 ? 0.5 * (c->ahead[BEYOND_AT] - last[K_CLOCK]) : INFINITY;
}

/* One Newton step at knot `made`, `span` after knot `last`; rejected if the arms or their slopes do not follow. */
static Trial try_knot(Core *c, int last, int made, double span, int iteration) {
    const double *from = knot(c, last), *o = c->options, clock = from[K_CLOCK] + span;
    double *x = vector_of(c, c->knot_positions, made), *step = sketch_of(c).step;
    if (iteration == 0) {
        const double *x0 = vector_of(c, c->knot_positions, last), *slope = vector_of(c, c->knot_slope, last);
        const double *curvature = vector_of(c, c->knot_curvature, last);
        const double bends = from[K_CORNER] == 0.0 ? 0.5 * span : 0.0;
        for (int j = 0; j < c->joints; j++) x[j] = x0[j] + (curvature[j] * bends + slope[j]) * span;
    }
    const Trial found = newton_step(c, clock, JUST_BEFORE, x, step, vector_of(c, c->knot_slope, made));
    if (found != FOUND) return found;
    const double largest = largest_size(step, c->joints);
    if (!(largest < o[JOINT_STEP])) return REJECTED;
    for (int j = 0; j < c->joints; j++) x[j] += step[j];
    if (!(largest < CONVERGED)) return iteration + 1 < MOST_TRIES ? PENDING : REJECTED;
    if (!bound_by_limits(c, last, made, clock, span)) return REJECTED;
    const double *k = knot(c, made);
    if (span > o[SHORTEST] && !(span * k[K_FASTEST] <= 1.5 * o[JOINT_STEP])) return REJECTED;
    const double most = span > FINE_CELL ? o[SLOPE_STEP] : OTHER_BRANCH;
    if (span > o[SHORTEST] && !(k[K_CHANGE] <= most * k[K_FASTEST])) return REJECTED;
    if (span > FINE_CELL && !bends_slowly(c, last, made)) return REJECTED;
    return constrain(c, made);
}

/* -- adding knots -------------------------------------------------------------------------------------------------- */

/* The first tentative knot becomes the last known one. */
static void push_knot(Core *c) {
    const int count = count_ahead(c, COUNT);
    c->ahead[COUNT] = count + 1;
    c->ahead[FRESH] += 1.0;
    if (knot(c, count)[K_CAP] == 0.0) c->ahead[COMPLETE] = 1.0; /* nothing comes after a stop */
    if (c->ahead[COMPLETE] != 0.0 || c->ahead[FRESH] >= KNOTS_PER_PASS) look_back(c);
}

/* Growth has come to a pause between two knots. */
static void rest_growth(Core *c) {
    c->ahead[GROWING] = c->ahead[WAY] = 0.0;
    c->ahead[BEGIN_AT] = INFINITY;
}

static int singular_arm(const Core *c, int i) {
    const double *slope = vector_of(c, c->knot_slope, i);
    double largest = -1.0;
    int fastest = 0;
    for (int j = 0; j < c->joints; j++) {
        const double share = fabs(slope[j]) / (isfinite(c->plan_speed[j]) ? c->plan_speed[j] : 1.0);
        if (share > largest) largest = share, fastest = j;
    }
    return arm_of(c, fastest);
}

/* The object stops at knot i. */
static void block_at(Core *c, int i, int arm, int joint, int kind) {
    const int count = count_ahead(c, COUNT);
    copy_knot(c, i, count);
    if (i < count) knot(c, count)[K_SPAN] = 0.0; /* the same knot again */
    knot(c, count)[K_CAP] = 0.0;
    name_cause(knot(c, count) + K_KIND, kind, arm, joint);
    push_knot(c);
    rest_growth(c);
}

/* Largest σ² at which every joint can change its slope within one step; the joint that makes it. */
static double jump_cap(const Core *c, const double *after, const double *before, int *joint) {
    double least = INFINITY;
    *joint = 0;
    for (int j = 0; j < c->joints; j++) {
        const double jump = fabs((after ? after[j] : 0.0) - before[j]);
        if (!(jump > 1e-9) || !(c->plan_jump[j] / jump < least)) continue;
        least = c->plan_jump[j] / jump;
        *joint = j;
    }
    return least * least;
}

/* The end of the path: where it ends moving, the joints have one step to stop in. */
static void finish_path(Core *c) {
    const int last = count_ahead(c, COUNT) - 1;
    int joint;
    if (c->accelerates) {
        const double cap = jump_cap(c, NULL, vector_of(c, c->knot_slope, last), &joint);
        if (cap < knot(c, last)[K_CAP]) {
            copy_knot(c, last, last + 1);
            knot(c, last + 1)[K_CAP] = cap;
            knot(c, last + 1)[K_SPAN] = 0.0;
            name_cause(knot(c, last + 1) + K_KIND, PATH_END, -1, -1);
            push_knot(c);
        }
    }
    c->ahead[COMPLETE] = 1.0;
    look_back(c);
    rest_growth(c);
}

/* Where the twist jumps at knot i: slopes after it, and the rate at which the joints can take the jump. */
static int turn_corner(Core *c, int i) {
    const Sketch s = sketch_of(c);
    double *k = knot(c, i), *slope = vector_of(c, c->knot_slope, i);
    const double clock = k[K_CLOCK] + 1e-9, *x = vector_of(c, c->knot_positions, i);
    const Trial found = newton_step(c, clock, JUST_BEFORE, x, s.step, s.after);
    if (found == CANNOT_SAY) return 0;
    if (found != FOUND) memset(s.after, 0, sizeof(double) * (size_t)c->joints);
    if (c->accelerates) {
        int joint = 0;
        double fastest = 0.0;
        for (int j = 0; j < c->joints; j++) {
            const double use = fabs(s.after[j]) * (1.0 / c->plan_speed[j]);
            if (use > fastest) fastest = use, joint = j;
        }
        if (1.0 / maximum(fastest * fastest, 1.0) < k[K_CAP]) {
            k[K_CAP] = 1.0 / maximum(fastest * fastest, 1.0);
            name_cause(k + K_KIND, VELOCITY, arm_of(c, joint), joint);
        }
        const double cap = jump_cap(c, s.after, slope, &joint);
        if (cap < k[K_CAP]) {
            k[K_CAP] = cap;
            name_cause(k + K_KIND, ACCELERATION, arm_of(c, joint), joint);
        }
    }
    memcpy(slope, s.after, sizeof(double) * (size_t)c->joints);
    k[K_CORNER] = 1.0;
    k[K_FASTEST] = largest_size(slope, c->joints);
    return 1;
}

/* -- position limits ----------------------------------------------------------------------------------------------- */

/* Leave at knot `made` the chain where joint j is at `position`, between knots `last` and `made`: regula falsi. */
static Trial close_in(Core *c, int last, int made, int j, double position) {
    double start = knot(c, last)[K_CLOCK], end = knot(c, made)[K_CLOCK];
    double miss_start = vector_of(c, c->knot_positions, last)[j] - position;
    double miss_end = vector_of(c, c->knot_positions, made)[j] - position;
    if (miss_start * miss_end >= 0.0) copy_knot(c, last, made); /* it is there already */
    for (int i = 0; i < 8 && miss_start * miss_end < 0.0; i++) {
        const double clock = start - miss_start * (end - start) / (miss_end - miss_start);
        const double span = clock - knot(c, last)[K_CLOCK];
        Trial found = PENDING;
        for (int n = 0; found == PENDING && span > 1e-9; n++) found = try_knot(c, last, made + 1, span, n);
        if (found == CANNOT_SAY) return CANNOT_SAY;
        if (found == REJECTED) return FOUND;
        copy_knot(c, found == FOUND ? made + 1 : last, made);
        const double miss = vector_of(c, c->knot_positions, made)[j] - position;
        if (!(fabs(miss) >= 1e-9)) return FOUND;
        if (miss * miss_end > 0.0)
            end = clock, miss_end = miss;
        else
            start = clock, miss_start = miss;
    }
    return FOUND;
}

/* Stop where the first joint meets a position limit between knots `last` and `made`; rejected if none does. A joint
 * outside may come back in: only going further out is the end. */
static Trial stop_at_limit(Core *c, int last, int made) {
    const double *x = vector_of(c, c->knot_positions, last), *ahead = vector_of(c, c->knot_positions, made);
    double first = INFINITY, position = 0.0;
    int joint = -1;
    for (int j = 0; j < c->joints; j++) {
        const int over = ahead[j] > maximum(c->high[j], x[j]), under = ahead[j] < minimum(c->low[j], x[j]);
        if (!over && !under) continue;
        const double limit = over ? c->high[j] : c->low[j];
        const double share = clamp((limit - x[j]) / (ahead[j] - x[j]), 0.0, 1.0);
        if (share < first) first = share, joint = j, position = limit;
    }
    if (joint < 0) return REJECTED;
    if (close_in(c, last, made, joint, position) == CANNOT_SAY) return CANNOT_SAY;
    knot(c, made)[K_SPAN] = knot(c, made)[K_CLOCK] - knot(c, last)[K_CLOCK];
    block_at(c, made, arm_of(c, joint), joint, POSITION);
    return FOUND;
}

/* -- growth, one Newton step at a time ----------------------------------------------------------------------------- */

/* Begin the knot after the last known or tentative one, as far on as the chain may be followed in one go. */
static void aim_ahead(Core *c) {
    const double *last = knot(c, count_ahead(c, COUNT) + count_ahead(c, WAY) - 1), *o = c->options;
    const double edge = next_breakpoint(c, last[K_CLOCK]);
    double span = minimum(o[CELL], c->duration - last[K_CLOCK]);
    if (last[K_FASTEST] > 0.0) span = minimum(span, o[JOINT_STEP] / last[K_FASTEST]);
    if (last[K_SPAN] > 0.0 && last[K_CORNER] == 0.0) span = minimum(span, GROWTH * last[K_SPAN]);
    if (last[K_CLOCK] + span > edge - 1e-9) span = edge - last[K_CLOCK];
    c->ahead[TRY_SPAN] = minimum(span, half_way(c, last));
    c->ahead[ITERATION] = 0.0;
    c->ahead[GROWING] = 1.0;
}

/* Whether a user's path jumps right after a clock; 0 where it cannot be asked. */
static int jumps_after(Core *c, double clock) {
    double R0[9], p0[3], R1[9], p1[3];
    const double ahead = minimum(clock + 2.0 * c->options[SHORTEST], c->duration);
    if (!path_pose(c, clock, R0, p0) || !path_pose(c, ahead, R1, p1)) return 0;
    return pose_distance(R0, p0, R1, p1) > FASTEST_PATH * (ahead - clock);
}

/* The chain cannot be followed past the last known knot, or past the singularity that the way leads to. */
static void end_growth(Core *c) {
    const int count = count_ahead(c, COUNT), way = count_ahead(c, WAY) > 0, at = way ? count : count - 1;
    const double rate = c->options[SINGULAR_RATE];
    if (!way && half_way(c, knot(c, at)) < 2.0 * c->options[SHORTEST]) {
        block_at(c, at, -1, (int)c->ahead[BEYOND] - 1, CONSTRAINT);
        return;
    }
    if (!way && jumps_after(c, knot(c, at)[K_CLOCK])) {
        block_at(c, at, -1, -1, PATH_JUMP);
        return;
    }
    const int arm = singular_arm(c, at);
    /* Where it is as bad already, the object stays: else it would creep on with every new path. */
    const int stays = way && knot(c, count - 1)[K_UNCAPPED] < rate * rate;
    block_at(c, stays ? count - 1 : at, arm, -1, way ? SINGULARITY : REACH);
}

static void reject_trial(Core *c) {
    c->ahead[TRY_SPAN] *= 0.5;
    c->ahead[ITERATION] = 0.0;
    if (!(c->ahead[TRY_SPAN] >= c->options[SHORTEST])) end_growth(c);
}

/* Whether the knot that was tried ends in a singularity, unless there is a way past it. */
static int nears_singularity(const Core *c, int made) {
    const double *k = knot(c, made), rate = c->options[SINGULAR_RATE];
    return k[K_UNCAPPED] < rate * rate && k[K_FASTEST] > knot(c, made - 1)[K_FASTEST];
}

/* Take the knot that was tried into the way past a singularity. 1 where the joints slow down; 0 where the way goes on,
 * or there is none and growth is over. */
static int go_past(Core *c, int made) {
    const int count = count_ahead(c, COUNT);
    const double rate = PASSABLE * c->options[SINGULAR_RATE], end = next_breakpoint(c, knot(c, count)[K_CLOCK]) - 1e-9;
    const double *k = knot(c, made);
    const int first = made == count;
    if (!first && (k[K_INSIDE] == 0.0 || k[K_UNCAPPED] < rate * rate || k[K_CLOCK] > end)) {
        end_growth(c);
        return 0;
    }
    c->ahead[WAY] += 1.0;
    if (!first && k[K_FASTEST] < knot(c, made - 1)[K_FASTEST]) return 1;
    if (c->ahead[WAY] >= LONGEST_WAY || k[K_CLOCK] >= end)
        end_growth(c);
    else
        aim_ahead(c);
    return 0;
}

/* Knots up to the one that was tried are known; 0 if the path, or a constraint, fails. */
static int accept_trial(Core *c) {
    const int last = count_ahead(c, COUNT) - 1, made = last + 1 + count_ahead(c, WAY);
    if (made == last + 1 && knot(c, made)[K_INSIDE] == 0.0) {
        const Trial stop = stop_at_limit(c, last, made);
        if (stop != REJECTED) return stop == FOUND;
    }
    if ((made > last + 1 || nears_singularity(c, made)) && !go_past(c, made)) return 1;
    const double edge = next_breakpoint(c, knot(c, last)[K_CLOCK]);
    const int corner = fabs(knot(c, made)[K_CLOCK] - edge) < 1e-9 && edge < c->duration;
    const int found = !corner || turn_corner(c, made);
    for (int i = last; found && i < made; i++) push_knot(c);
    rest_growth(c);
    return found;
}

/* One Newton step, so that no single control step has to make a whole knot; 0 where growth has to wait, −1 where it cannot
 * be said what is ahead. */
static int work_ahead(Core *c) {
    const int count = count_ahead(c, COUNT), made = count + count_ahead(c, WAY);
    if (made + 2 + count_ahead(c, KEPT) > MOST_KNOTS) return 0; /* close_in needs a knot beside the one that is tried */
    if (c->ahead[GROWING] == 0.0) {
        if (!(c->duration - knot(c, count - 1)[K_CLOCK] > 1e-12)) {
            finish_path(c);
            return 1;
        }
        aim_ahead(c);
    }
    if (half_way(c, knot(c, made - 1)) < c->options[SHORTEST]) {
        end_growth(c);
        return 1;
    }
    switch (try_knot(c, made - 1, made, c->ahead[TRY_SPAN], (int)c->ahead[ITERATION])) {
    case PENDING: c->ahead[ITERATION] += 1.0; return 1;
    case REJECTED: reject_trial(c); return 1;
    case FOUND:
        if (accept_trial(c)) return 1;
        break;
    case CANNOT_SAY: break;
    }
    rest_growth(c);
    return -1;
}

/* -- the horizon --------------------------------------------------------------------------------------------------- */

/* Drop knots that another follows before `clock`. */
static void leave_behind(Core *c, double clock) {
    while (c->ahead[COUNT] > 1.0 && knot(c, 1)[K_CLOCK] <= clock) {
        c->ahead[HEAD] = place_of(c, 1);
        c->ahead[COUNT] -= 1.0;
        c->ahead[KNOWN] = maximum(c->ahead[KNOWN] - 1.0, 0.0);
    }
}

/* Number of the last knot at or before `clock`. */
static int knot_before(const Core *c, double clock) {
    int i = 0;
    while (i + 1 < count_ahead(c, COUNT) && knot(c, i + 1)[K_CLOCK] <= clock) i++;
    return i;
}

/* Whether K is known for good where a step from `clock` on goes: the end of the horizon does not make it. */
static int reaches(const Core *c, double clock, double dt) {
    const int settled = count_ahead(c, KNOWN);
    return settled > 0 && knot(c, settled - 1)[K_CLOCK] > clock + 2.0 * dt;
}

/* The arms hold where it cannot be said what is ahead, until it can. */
static void hold_blind(Core *c) {
    if (c->proposal[WATCH_CAP] > 0.0) refuse(c, LOOK_AHEAD_FAILED, -1, c->loop[CLOCK]);
}

/* Grow the horizon until it reaches far enough, or by that many Newton steps. */
static void extend_horizon(Core *c, double clock, double dt, int newton_steps) {
    for (int i = 0; i < newton_steps; i++) {
        leave_behind(c, clock);
        if (c->ahead[COMPLETE] != 0.0 || reaches(c, clock, dt)) return;
        const int grown = work_ahead(c);
        if (grown < 0) hold_blind(c);
        if (grown <= 0) return;
    }
}

/* Clock until which the known horizon lets the object go on at full rate. */
static double known_free(const Core *c, double dt) {
    const double margin = 2.0 * maximum(dt, c->options[NOMINAL_DT]);
    double clock = -INFINITY;
    for (int i = 0; i < count_ahead(c, COUNT); i++) {
        if (!(knot(c, i)[K_SQUARE] >= 1.0)) return clock - margin;
        clock = knot(c, i)[K_CLOCK];
    }
    return c->ahead[COMPLETE] != 0.0 ? INFINITY : clock - margin;
}

/* -- the cap ------------------------------------------------------------------------------------------------------- */

/* The least K of a step, its slope over the step's rate, and the knot that makes it. */
typedef struct {
    double square, slope;
    int cause;
} Least;

/* K between knot i and the next one, its slope over the clock, and which of them makes it. */
static Least square_after(const Core *c, int i, double clock) {
    const double *here = knot(c, i);
    if (i + 1 == count_ahead(c, COUNT)) return (Least){here[K_SQUARE], 0.0, i};
    const double *ahead = knot(c, i + 1), slope = (ahead[K_SQUARE] - here[K_SQUARE]) / (ahead[K_CLOCK] - here[K_CLOCK]);
    return (Least){here[K_SQUARE] + (clock - here[K_CLOCK]) * slope, slope, slope < 0.0 ? i + 1 : i};
}

/* The least K of a step: in its middle, at its end, and at the knots on its way. */
static Least least_square(const Core *c, double clock, double rate, double dt) {
    const double parts[2] = {0.5 * dt, dt};
    const int count = count_ahead(c, COUNT);
    int i = knot_before(c, clock);
    Least least = {INFINITY, 0.0, i};
    for (int part = 0; part < 2; part++) {
        const double at = clock + rate * parts[part];
        while (i + 1 < count && knot(c, i + 1)[K_CLOCK] <= at)
            if (knot(c, ++i)[K_SQUARE] < least.square) least = (Least){knot(c, i)[K_SQUARE], 0.0, i};
        const Least there = square_after(c, i, at);
        if (there.square < least.square) least = (Least){there.square, there.slope * parts[part], there.cause};
    }
    return least;
}

/* The rate σ with σ² = K + slope (σ − rate). */
static double met_by(Least l, double rate) {
    const double half = 0.5 * l.slope;
    return half + sqrt(maximum(half * half + l.square - l.slope * rate, 0.0));
}

/* The largest rate below 1 that K admits for a step; 0 is always admissible. `least` is that of rate 1, then that of the
 * rate. K is linear between knots: the next guess is where σ² meets the line that makes it, or half way. */
static double largest_rate(const Core *c, double clock, double dt, Least *least) {
    double low = 0.0, high = 1.0, rate = 1.0;
    Least there = *least;
    for (int i = 0; i < MOST_GUESSES; i++) {
        const double guess = (1.0 - SHORT_OF) * met_by(there, rate);
        rate = low < guess && guess < high ? guess : 0.5 * (low + high);
        there = least_square(c, clock, rate, dt);
        if (!(rate * rate <= there.square)) {
            high = rate;
            continue;
        }
        low = rate, *least = there;
        if ((1.0 - 2.0 * SHORT_OF) * met_by(there, rate) <= rate) break;
    }
    return low >= LEAST_RATE ? low : 0.0;
}

/* The cap of a step, from a horizon that is grown for it, and the knot that makes it; −1 if none does. */
static double cap_on_horizon(Core *c, double clock, double dt, int *cause) {
    double *a = c->ahead;
    Least least = least_square(c, clock, 1.0, dt);
    *cause = -1;
    if (least.square >= 1.0) {
        a[FREE_UNTIL] = known_free(c, dt);
        a[BEGIN_AT] = a[FREE_UNTIL] < INFINITY ? a[FREE_UNTIL] - STEPS_TO_GROW * c->options[NOMINAL_DT] : INFINITY;
        return 1.0;
    }
    const double rate = largest_rate(c, clock, dt, &least);
    *cause = least.cause;
    a[ENDS] = knot(c, *cause)[K_STOPS];
    return rate;
}

/* -- what core.h promises ------------------------------------------------------------------------------------------ */

/* Newton's method from x to a pose; the arm that does not get there, or −1. */
static int reach_pose(Core *c, const double *R, const double *p, double *x) {
    static const double still[6];
    const Sketch s = sketch_of(c);
    double largest = INFINITY;
    int arm = 0;
    for (int i = 0; i <= STARTING_STEPS; i++) {
        carry_and_linearise(c, x, p, s.carried, s.jacobian);
        for (int k = 0; k < c->arms; k++) s.errors[6 * k] = NAN;
        const int known = errors_at(c, s.carried, R, p, s.errors);
        largest = -1.0;
        for (int k = c->arms - 1; k >= 0; k--) {
            const double size = known || isfinite(s.errors[6 * k]) ? largest_size(s.errors + 6 * k, 6) : INFINITY;
            if (size >= largest) largest = size, arm = k;
        }
        if (!known) break;
        if (largest <= 1e-10 || i == STARTING_STEPS) break;
        twists_back(c, R, s.errors, s.w);
        if (!two_velocities(c, s.jacobian, s.w, still, NULL, NULL, s.step, s.after)) break;
        const double length = largest_size(s.step, c->joints);
        const double share = length > LONGEST_STEP ? LONGEST_STEP / length : 1.0;
        for (int j = 0; j < c->joints; j++) x[j] += share * s.step[j];
    }
    return largest < 1e-6 ? -1 : arm;
}

/* The first knot, at the commanded positions; none if the path fails. */
static void start_knots(Core *c, double clock) {
    double R[9], p[3], *x = vector_of(c, c->knot_positions, 0), *slope = vector_of(c, c->knot_slope, 0);
    const size_t bytes = sizeof(double) * (size_t)c->joints;
    if (!path_pose(c, clock, R, p)) return;
    memcpy(x, c->positions, bytes);
    const int arm = reach_pose(c, R, p, x);
    memset(slope, 0, bytes);
    if (arm < 0) {
        const Trial found = newton_step(c, clock, 0.0, x, sketch_of(c).step, slope);
        if (found == CANNOT_SAY) return;
        if (found != FOUND) memset(slope, 0, bytes);
    }
    bound_by_limits(c, -1, 0, clock, 1.0);
    if (arm >= 0)
        block_at(c, 0, arm, -1, REACH);
    else
        push_knot(c);
}

static void preview_try(Core *c, double clock, int kept) {
    const int head = kept ? place_of(c, kept) : 0;
    memset(c->ahead, 0, sizeof(double) * N_AHEAD);
    c->ahead[HEAD] = head, c->ahead[KEPT] = kept;
    c->ahead[FREE_UNTIL] = -INFINITY;
    c->ahead[BEGIN_AT] = INFINITY;
    start_knots(c, clock);
    if (c->ahead[COUNT] > 0.0) extend_horizon(c, clock, c->options[NOMINAL_DT], NEWTON_STEPS_AT_START);
}

static void preview_reset(Core *c, double clock) { preview_try(c, clock, 0); }

static double preview_cap(Core *c, double clock, double dt) {
    double *a = c->ahead;
    int cause = -1;
    name_cause(c->proposal + CAP_KIND, NONE, -1, -1);
    if (!(isfinite(clock) && isfinite(dt))) return 0.0;
    if (a[COUNT] == 0.0) start_knots(c, clock); /* the path failed where it began */
    if (a[COUNT] == 0.0) {
        hold_blind(c);
        return 0.0;
    }
    if (clock < a[FREE_UNTIL] && dt <= c->options[NOMINAL_DT]) {
        if (clock >= a[BEGIN_AT]) work_ahead(c);
        return 1.0;
    }
    extend_horizon(c, clock, dt, (int)c->options[NEWTON_STEPS]);
    if (a[COMPLETE] == 0.0 && !reaches(c, clock + STEPS_TO_GROW * dt, dt)) work_ahead(c);
    a[ENDS] = 0.0;
    const double cap = cap_on_horizon(c, clock, dt, &cause);
    for (int i = 0; cause >= 0 && i < 3; i++) c->proposal[CAP_KIND + i] = knot(c, cause)[K_CAUSE_KIND + i];
    return cap > 0.0 ? cap : 0.0;
}

/* Largest rise of σ near a clock by further constraints, and by joints that no step limits; the joint, or −1. */
static double preview_rise(const Core *c, double clock, int *joint) {
    const int count = count_ahead(c, COUNT);
    *joint = -1;
    if (!count) return INFINITY;
    const int i = knot_before(c, clock), ahead = i + 1 < count ? i + 1 : i;
    const double rise = minimum(knot(c, i)[K_RISE], knot(c, ahead)[K_RISE]);
    if (c->accelerates) return rise;
    const double *slope = vector_of(c, c->knot_slope, i), *next = vector_of(c, c->knot_slope, ahead);
    double most = 0.0;
    int tightest = 0;
    for (int j = 0; j < c->joints; j++) {
        const double share = maximum(fabs(slope[j]), fabs(next[j])) / c->plan_acceleration[j];
        if (share > most) most = share, tightest = j;
    }
    if (!(most > 0.0 && 1.0 / most < rise)) return rise;
    *joint = tightest;
    return 1.0 / most;
}

/* q′ and q″ at a clock, from the knots around it: q′ is linear between two knots, q″ between the middles of intervals.
 * Where the slopes of a corner lie between, the knot on this side counts alone. */
static void joints_at(const Core *c, double clock, double *slope, double *curvature) {
    const int i = knot_before(c, clock), last = count_ahead(c, COUNT) - 1, n = c->joints;
    const size_t bytes = sizeof(double) * (size_t)n;
    const double *here = vector_of(c, c->knot_slope, i), *before = vector_of(c, c->knot_curvature, i);
    memcpy(slope, here, bytes);
    memcpy(curvature, before, bytes);
    if (i == last || !(knot(c, i + 1)[K_CLOCK] > knot(c, i)[K_CLOCK])) return;
    const double since = clock - knot(c, i)[K_CLOCK], share = since / (knot(c, i + 1)[K_CLOCK] - knot(c, i)[K_CLOCK]);
    const int border = share < 0.5 ? i : i + 1, beside = share < 0.5 ? i : i + 2 > last ? last : i + 2;
    const double *own = vector_of(c, c->knot_curvature, i + 1), *other = vector_of(c, c->knot_curvature, beside);
    const int alone = knot(c, border)[K_CORNER] != 0.0 || knot(c, beside)[K_SPAN] == 0.0;
    const double towards = alone ? 0.0 : fabs(share - 0.5);
    for (int j = 0; j < n; j++) {
        slope[j] = here[j] + since * own[j];
        curvature[j] = own[j] + towards * (other[j] - own[j]);
    }
}

/* D: from (η a + c σ²) / (|q′| + max(c, 0) σ dt) with c = q″ sign q′ of every joint that moves. */
static double preview_brake(const Core *c, double clock, double dt, double rate) {
    double *slope = c->scratch, *curvature = slope + c->joints, least = INFINITY;
    /* A corner takes the whole acceleration: the rate stays while it is passed. */
    if (next_breakpoint(c, clock - rate * dt) <= minimum(clock + rate * dt, c->duration - 1e-9)) return 0.0;
    joints_at(c, clock, slope, curvature);
    for (int j = 0; j < c->joints; j++) {
        const double speed = fabs(slope[j]), bend = slope[j] < 0.0 ? -curvature[j] : curvature[j];
        if (!(speed > 0.0)) continue;
        least = minimum(least, (c->plan_acceleration[j] + bend * rate * rate) / (speed + maximum(bend, 0.0) * rate * dt));
    }
    return least;
}

static void preview_reference(Core *c, double clock, double *positions, double *slope) {
    if (c->ahead[COUNT] == 0.0) {
        memcpy(positions, c->positions, sizeof(double) * (size_t)c->joints);
        memset(slope, 0, sizeof(double) * (size_t)c->joints);
        return;
    }
    leave_behind(c, clock);
    const int ahead = c->ahead[COUNT] > 1.0 ? 1 : 0;
    const double *x = vector_of(c, c->knot_positions, 0), *first = vector_of(c, c->knot_slope, 0);
    const double *second = vector_of(c, c->knot_slope, ahead);
    const double span = knot(c, ahead)[K_CLOCK] - knot(c, 0)[K_CLOCK];
    const double share = span > 0.0 ? clamp((clock - knot(c, 0)[K_CLOCK]) / span, 0.0, 1.0) : 0.0;
    /* Quadratic from the knot before: exact to second order, continuous to third. */
    for (int j = 0; j < c->joints; j++) {
        slope[j] = first[j] + share * (second[j] - first[j]);
        positions[j] = x[j] + 0.5 * (first[j] + slope[j]) * (share * span);
    }
}
