/* How fast the object may be at a grid point: linear programs of two variables, z = σ² and u = σ̇.
 *
 * Between two grid points the joints move at q′σ and accelerate at q′u + q″z; z changes by 2u per second of clock. From a grid point
 * with z the object has to be able to reach the next one with at most K there, within the accelerations. Unknown changes
 * of q″ between the grid points count as a share e of its known changes. The largest such z is K here: a backward pass, as in
 * TOPP-RA (Pham & Pham, 2018), over the known horizon. See "Look-ahead" in docs/derivations.md. */

#include "ahead.h"

constexpr double CROSSED = 1e-13; /* the lower bound of σ̇ is above the upper one by more than rounding */
constexpr int MOST_PIVOTS = 50; /* Newton steps of one program of two variables */

/* Lines α u + β z ≤ γ, as bounds (γ − β z)/α of u: upper ones from the front of the tables, lower ones from their back.
 * `high` and `low` are the pair that makes z, −1 where none does; `still` is the row of a bound of z alone. */
struct Lines {
    double *share, *slope, *row;
    int ups, downs, room, still, high, low;
    double square;
};

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
    return Lines{c->lines, c->lines + room, c->lines + 2 * room, 0, 0, room, -1, -1, -1, cap};
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
        if (!(over > CROSSED * (1.0 + fabs(low)))) break; /* at rest at the latest: every bound is on its side of 0 */
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

static double largest_alone(const Core *c, int i) {
    const double *slope = vector_of(c, c->node_slope, i), *bend = vector_of(c, c->node_curvature, i);
    Lines l = lines_of(c, node(c, i)->cap);
    for (int j = 0; j < c->joints; j++) add_pair(&l, slope[j], bend[j], bend[j], 0.0, c->plan_acceleration[j], j);
    add_pair(&l, 1.0, 0.0, 0.0, 0.0, c->options->slope_cap, c->joints);
    return largest_z(&l);
}

static int find_share(Core *c, int i) {
    Node *here = node(c, i);
    const Node *ahead = node(c, i + 1);
    const double *slope = vector_of(c, c->node_slope, i), *chord = vector_of(c, c->node_curvature, i + 1);
    const double *before = vector_of(c, c->node_curvature, i), *after = chord, *a = c->plan_acceleration;
    const double span = ahead->span, two = 2.0 * span, most = c->options->slope_cap;
    double span_before = 0.0, span_after = 0.0;
    Lines l = lines_of(c, here->cap);
    if (here->span > 0.0 && !here->corner) span_before = here->span;
    if (i + 2 < c->ahead->count && !ahead->corner) {
        after = vector_of(c, c->node_curvature, i + 2);
        span_after = node(c, i + 2)->span;
    }
    for (int j = 0; j < c->joints; j++) {
        const double C = chord[j], arrival = slope[j] + C * span;
        const double b = span_before > 0.0 ? (before[j] * span + C * span_before) / (span_before + span) : C;
        const double d = span_after > 0.0 ? (C * span_after + after[j] * span) / (span + span_after) : C;
        const double doubt = c->options->doubt * (fabs(b - C) + fabs(d - C));
        const double high = maximum(d, C), low = minimum(d, C);
        add_pair(&l, slope[j], b, C, doubt, a[j], j);
        add_line(&l, two * (doubt + high) + arrival, doubt + high, a[j], j);
        add_line(&l, two * (doubt - low) - arrival, doubt - low, a[j], j);
    }
    add_line(&l, 1.0, 0.0, minimum(most, minimum(here->rise, ahead->rise)), c->joints);
    add_line(&l, -1.0, 0.0, minimum(most, minimum(here->fall, ahead->fall)), c->joints);
    add_line(&l, -two, -1.0, 0.0, c->joints);
    add_line(&l, two, 1.0, ahead->square, c->joints + 1);
    const double z = largest_z(&l);
    here->square = z;
    here->line_slope = 0.0;
    here->line_to = INFINITY;
    const int high = l.high < 0 ? l.still : (int)l.row[l.high], low = l.low < 0 ? -1 : (int)l.row[l.low];
    if (high == c->joints + 1) {
        const double share = l.share[l.low], falls = l.slope[l.low], end = largest_along(&l, z, l.high);
        here->line_slope = 1.0 / (1.0 - two * falls);
        here->line_to = end + two * (share - falls * end);
    }
    return high >= 0 && high < c->joints ? high : low >= 0 && low < c->joints ? low : -1;
}
