/* The known grid points, K at each of them, and the largest rate that K admits for a step. */

#include "ahead.h"

constexpr int NODES_PER_PASS = 4; /* grid points per backward pass */
constexpr int MOST_GUESSES = 44; /* guesses of the largest rate */
constexpr double SHORT_OF = 1e-14; /* share by which they stay below a line's */
constexpr double SHORTER = 4.0; /* that share grows by this factor after a guess that was too large */
constexpr double LEAST_RATE = 1e-9; /* a smaller rate is 0 */

/* Whether a rate may be admitted is asked while fewer grid points are known: a limit near by shows then; a rate that misses by less
 * may be one that rounding has lowered. */
#define MOST_HOPED 16
#define HOPED_ROUNDING 1e-6

/* K at grid point i from K at the next one, and its cause; 1 if that is K ahead. K only rises from one pass to the next,
 * and follows K ahead along a line from since, where it was found, to until. */
static int share_at(Core *c, int i) {
    Node *here = node(c, i);
    const Node *ahead = node(c, i + 1);
    const double then = ahead->square;
    int joint = -1;
    if (here->line_from <= then && then <= here->line_to && then < 1.0) {
        here->square = here->line_square + here->line_slope * (then - here->line_from);
    } else {
        if (ahead->span == 0.0) { /* the same grid point again, with a lower cap */
            here->square = then;
            here->line_slope = 1.0;
            here->line_to = INFINITY;
        } else {
            joint = find_share(c, i);
        }
        here->line_square = here->square;
        here->line_from = then;
    }
    const int by_ahead = here->line_slope > 0.0;
    if (by_ahead && (then < 1.0 || joint < 0))
        here->cause = ahead->cause, here->stops = ahead->stops;
    else if (joint >= 0)
        name_cause(here->cause, ACCELERATION, arm_of(c, joint), joint), here->stops = false;
    else
        here->cause = here->limit, here->stops = here->cap == 0.0;
    return by_ahead;
}

/* Find K from the last grid point back to the first one whose K is known for good. Where more grid points may come the object rests
 * at the last grid point but one: q″ is not known at the last. */
static void look_back(Core *c) {
    const int count = c->ahead->count, complete = c->ahead->complete, end = count - (complete ? 1 : 2);
    int settled = complete ? count : 0;
    c->ahead->fresh = 0;
    if (end < 0) return;
    if (complete) {
        Node *last = node(c, end);
        last->square = last->cap;
        last->cause = last->limit;
        last->stops = last->cap == 0.0;
    }
    for (int i = end - 1; i >= c->ahead->settled; i--)
        if (!share_at(c, i) && !settled) settled = i + 1;
    c->ahead->settled = std::max(c->ahead->settled, settled);
}

static void push_node(Core *c) {
    const int count = c->ahead->count;
    c->ahead->count = count + 1;
    c->ahead->fresh++;
    if (node(c, count)->cap == 0.0) c->ahead->complete = true; /* nothing comes after a stop */
    if (c->ahead->complete || c->ahead->fresh >= NODES_PER_PASS) look_back(c);
}

static void finish_horizon(Core *c) {
    c->ahead->complete = true;
    look_back(c);
}

static void leave_behind(Core *c, double clock) {
    while (c->ahead->count > 1 && node(c, 1)->clock <= clock) {
        c->ahead->head = place_of(c, 1);
        c->ahead->count--;
        c->ahead->settled = std::max(c->ahead->settled - 1, 0);
    }
}

static int node_before(const Core *c, double clock) {
    int i = 0;
    while (i + 1 < c->ahead->count && node(c, i + 1)->clock <= clock) i++;
    return i;
}

static int reaches(const Core *c, double clock, double dt) {
    const int settled = c->ahead->settled;
    return settled > 0 && node(c, settled - 1)->clock > clock + 2.0 * dt;
}

/* q′ and q″ at a clock, from the grid points around it: q′ is linear between two grid points, q″ between the middles of intervals.
 * Where the slopes of a corner lie between, the grid point on this side counts alone. */
static void joints_at(const Core *c, double clock, double *slope, double *curvature) {
    const int i = node_before(c, clock), last = c->ahead->count - 1, n = c->joints;
    const size_t bytes = sizeof(double) * (size_t)n;
    const double *here = vector_of(c, c->node_slope, i), *before = vector_of(c, c->node_curvature, i);
    memcpy(slope, here, bytes);
    memcpy(curvature, before, bytes);
    if (i == last || !(node(c, i + 1)->clock > node(c, i)->clock)) return;
    const double since = clock - node(c, i)->clock, share = since / (node(c, i + 1)->clock - node(c, i)->clock);
    const int border = share < 0.5 ? i : i + 1, beside = share < 0.5 ? i : i + 2 > last ? last : i + 2;
    const double *own = vector_of(c, c->node_curvature, i + 1), *other = vector_of(c, c->node_curvature, beside);
    const int alone = node(c, border)->corner || node(c, beside)->span == 0.0;
    const double towards = alone ? 0.0 : fabs(share - 0.5);
    for (int j = 0; j < n; j++) {
        slope[j] = here[j] + since * own[j];
        curvature[j] = own[j] + towards * (other[j] - own[j]);
    }
}

static double free_until(const Core *c, double margin) {
    double clock = -INFINITY;
    for (int i = 0; i < c->ahead->count; i++) {
        if (!(node(c, i)->square >= 1.0)) return clock - margin;
        clock = node(c, i)->clock;
    }
    return c->ahead->complete ? INFINITY : clock - margin;
}

/* K between grid point i and the next one, its slope over the clock, and which of them makes it. */
static Least square_after(const Core *c, int i, double clock) {
    const Node *here = node(c, i);
    if (i + 1 == c->ahead->count) return Least{here->square, 0.0, i};
    const Node *ahead = node(c, i + 1);
    const double slope = (ahead->square - here->square) / (ahead->clock - here->clock);
    return Least{here->square + (clock - here->clock) * slope, slope, slope < 0.0 ? i + 1 : i};
}

/* The least K of a step: in its middle, at its end, and at the grid points on its way. */
static Least least_square(const Core *c, double clock, double rate, double dt) {
    const double parts[2] = {0.5 * dt, dt};
    const int count = c->ahead->count;
    int i = node_before(c, clock);
    Least least = {INFINITY, 0.0, i};
    for (int part = 0; part < 2; part++) {
        const double at = clock + rate * parts[part];
        while (i + 1 < count && node(c, i + 1)->clock <= at)
            if (node(c, ++i)->square < least.square) least = Least{node(c, i)->square, 0.0, i};
        const Least there = square_after(c, i, at);
        if (there.square < least.square) least = Least{there.square, there.slope * parts[part], there.cause};
    }
    return least;
}

/* The rate σ with σ² = K + slope (σ − rate). */
static double met_by(Least l, double rate) {
    const double half = 0.5 * l.slope;
    return half + sqrt(maximum(half * half + l.square - l.slope * rate, 0.0));
}

/* The largest rate below 1 that K admits for a step; 0 is always admissible. `least` is the least K at rate 1, on
 * return at the rate found. K is linear between grid points: the next guess is where σ² meets the line that makes it, or half
 * way. After a miss guesses stay shorter: beside a clock a small rate has few digits. */
static double largest_rate(const Core *c, double clock, double dt, Least *least) {
    double low = 0.0, high = 1.0, rate = 1.0, short_of = SHORT_OF;
    Least there = *least;
    for (int i = 0; i < MOST_GUESSES; i++) {
        const double guess = (1.0 - short_of) * met_by(there, rate);
        const int inside = low < guess && guess < high;
        rate = inside ? guess : 0.5 * (low + high);
        there = least_square(c, clock, rate, dt);
        if (!(rate * rate <= there.square)) {
            high = rate;
            if (inside) short_of *= SHORTER;
            continue;
        }
        low = rate, *least = there;
        if ((1.0 - 2.0 * short_of) * met_by(there, rate) <= rate) break;
    }
    return low >= LEAST_RATE ? low : 0.0;
}

/* Whether K admits a rate for a step, as far as grid points are known: it only rises as more become known. */
static int admits_rate(const Core *c, double clock, double dt, double rate) {
    const int end = c->ahead->count - 2; /* where the object would rest */
    if (!(rate <= 1.0) || c->ahead->fresh != 0 || end < 0 || !(node(c, end)->clock >= clock + dt)) return 0;
    return rate * rate <= least_square(c, clock, rate, dt).square;
}

/* K is at most what it would be if the object might pass the last grid point but one as fast as that alone allows; q″ is not known
 * at the last. A rate needs its square at a clock of the step. */
static int may_admit(Core *c, double clock, double dt, double rate) {
    const int end = c->ahead->count - 2, first = node_before(c, clock);
    Node kept[MOST_HOPED];
    if (!(rate > 0.0) || c->ahead->complete || end < 1 || end >= MOST_HOPED || node(c, end)->clock < clock + dt) return 1;
    for (int i = 0; i <= end; i++) kept[i] = *node(c, i);
    node(c, end)->square = node(c, end)->cap;
    for (int i = end - 1; i >= first; i--)
        if (node(c, i + 1)->span == 0.0) node(c, i)->square = node(c, i + 1)->square; /* the same grid point again */
        else find_share(c, i);
    double most = square_after(c, first, clock).square;
    int i = first;
    while (node(c, i + 1)->clock < clock + dt) most = maximum(most, node(c, ++i)->square);
    most = maximum(most, square_after(c, i, clock + dt).square);
    for (int k = 0; k <= end; k++) *node(c, k) = kept[k];
    const double least = rate - HOPED_ROUNDING;
    return !(most < least * least);
}
