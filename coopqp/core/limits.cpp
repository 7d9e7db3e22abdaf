/* Admissible joint velocities of a step, and the rates along the path that stay inside them. */

#include "functions.h"

/* Share of a distance that rounding may take from it. */
#define STOPS_SURELY 1e-9

/* Largest speed from which distance d ≥ 0 suffices to stop: v h + v²/(2a) = d, without cancellation. */
static double stopping_speed(double d, double a, double h) {
    if (!isfinite(a) || !isfinite(d)) return d / h;
    const double step = a * h;
    return 2.0 * a * d / (sqrt(step * step + 2.0 * a * d) + step);
}

/* Whether a speed is surely below stopping_speed(), by its square; false where no acceleration is limited. */
static bool stops_within(double speed, double d, double a, double h) {
    return speed * (2.0 * a * h + speed) < (1.0 - STOPS_SURELY) * (2.0 * a * d);
}

/* The fastest that joint j may be in a step of any motion: without a velocity and an acceleration limit it moves by
 * LARGEST_MOVE at most, and a hold brakes it. */
static double fastest(const Core *c, int j, double h) {
    if (c->most_move[j] == INFINITY) return c->speed[j];
    const double most = c->most_move[j] / h;
    return c->proposal->hold ? min_of(most, max_of(HELD_SPEED, HELD_SHARE * fabs(c->velocity[j]))) : most;
}

/* The box lower ≤ v ≤ upper, never empty; where limits conflict, acceleration wins. From outside a position limit it only
 * forbids going further out. Returns 0 if a joint is outside, or a number is not finite. */
static int box(Core *c, double h) {
    int inside = 1;
    for (int j = 0; j < c->joints; j++) {
        const double x = c->positions[j], up = c->high[j] - x, down = x - c->low[j];
        const double a = c->acceleration[j], v = c->velocity[j];
        if (!(up >= 0.0 && down >= 0.0 && isfinite(v))) inside = 0;
        const double speed = fastest(c, j, h), most_up = minimum(speed, v + a * h), most_down = minimum(speed, a * h - v);
        double upper = speed, lower = -speed; /* a stop binds where a step could reach its speed */
        if (!stops_within(most_up, up, a, h)) upper = min_of(speed, stopping_speed(max_of(up, 0.0), a, h));
        if (!stops_within(most_down, down, a, h)) lower = -min_of(speed, stopping_speed(max_of(down, 0.0), a, h));
        if (isfinite(a)) {
            upper = clamp(upper, v - a * h, v + a * h);
            lower = clamp(lower, v - a * h, v + a * h);
        }
        c->upper[j] = upper;
        c->lower[j] = lower;
    }
    return inside;
}

/* The joints outside their limits (1 in `outside`), and the velocities that lead them back a little beyond the limit.
 * Returns how many; −1 if a number is not finite. After box(). */
static int lead_back(Core *c, double h) {
    int count = 0;
    for (int j = 0; j < c->joints; j++) {
        const double x = c->positions[j], up = c->high[j] - x, down = x - c->low[j];
        const double share = RECOVERY_SHARE * (isfinite(c->speed[j]) ? c->speed[j] : 1.0);
        if (!isfinite(x) || !isfinite(c->velocity[j])) return -1;
        c->recovery[j] = 0.0;
        c->outside[j] = up < 0.0 || down < 0.0;
        if (c->outside[j] == 0.0) continue;
        const double way = clamp((up < 0.0 ? up - INSIDE : INSIDE - down) / h, -share, share);
        c->recovery[j] = clamp(way, c->lower[j], c->upper[j]);
        count++;
    }
    return count;
}

/* Whether the command stays inside all limits from inside, without a need to clip: the box without its divisions. */
static int well_inside(const Core *c, double h) {
    int inside = !c->proposal->hold; /* a hold brakes joints without limits */
    for (int j = 0; j < c->joints; j++) {
        const double v = c->command[j], speed = fabs(v), a = c->acceleration[j];
        const double up = c->high[j] - c->positions[j], down = c->positions[j] - c->low[j];
        const double way = speed * h + speed * speed * (0.5 / a), change = fabs(v - c->velocity[j]);
        inside &= (way <= (v > 0.0 ? up : down)) & (up >= 0.0) & (down >= 0.0) & (speed <= c->speed[j]) & (speed * h <= c->most_move[j]) &
                  (change <= a * h) & (change < INFINITY);
    }
    return inside;
}

/* G v of one further row */
static double further(const Core *c, int row, const double *v) {
    return Given(c->further + c->joints * row, c->joints).dot(Given(v, c->joints));
}

static int within(double x, double low, double high, double tolerance) {
    return x <= high + tolerance && x >= low - tolerance;
}

static int admissible(const Core *c) {
    for (int j = 0; j < c->joints; j++)
        if (!within(c->command[j], c->lower[j], c->upper[j], LIMIT_TOLERANCE)) return 0;
    return 1;
}

static int further_admissible(const Core *c, double tolerance) {
    for (int r = 0; r < c->further_rows; r++)
        if (!within(further(c, r, c->command), c->further_lower[r], c->further_upper[r], tolerance)) return 0;
    return 1;
}

/* Bring the command into the box; 0 if that takes more than `tolerance`, or a number is not finite. */
static int clip(Core *c, double tolerance) {
    for (int j = 0; j < c->joints; j++) {
        const double x = c->command[j];
        c->command[j] = clamp(x, c->lower[j], c->upper[j]);
        if (!(fabs(x - c->command[j]) <= tolerance)) return 0;
    }
    return 1;
}

/* The rates σ that rows of base + σ along leave, and the row that makes the highest. */
struct Rates {
    double low, high, low_slack, high_slack, side;
    int row;
};

/* 0 if no rate is admissible. */
static int narrow(Rates *rates, int row, double base, double along, double lower, double upper) {
    const double up = upper - base, down = lower - base;
    if (!isfinite(base)) return 0;
    if (fabs(along) < STILL_SLOPE) return up >= -LIMIT_TOLERANCE && down <= LIMIT_TOLERANCE;
    const double inverse = 1.0 / along, slack = LIMIT_TOLERANCE * fabs(inverse);
    const double first = (along > 0.0 ? down : up) * inverse, last = (along > 0.0 ? up : down) * inverse;
    if (last < rates->high) {
        rates->high = last, rates->high_slack = slack;
        rates->row = row, rates->side = along > 0.0 ? 1.0 : -1.0;
    }
    if (first > rates->low) rates->low = first, rates->low_slack = slack;
    return 1;
}

enum RowsKept { ALL_ROWS, ONLY_HARD_ROWS, NO_ROWS };

/* The rates at which base + rate · along keeps the box and further rows; 0 if none does. */
static int admissible_rates(const Core *c, const double *base, const double *along, RowsKept kept, Rates *rates) {
    *rates = {-INFINITY, INFINITY, 0.0, 0.0, 0.0, -1};
    for (int j = 0; j < c->joints; j++)
        if (!narrow(rates, j, base[j], along[j], c->lower[j], c->upper[j])) return 0;
    for (int r = 0; kept != NO_ROWS && r < c->further_rows; r++) {
        if (kept == ONLY_HARD_ROWS && c->further_soft[r] != 0.0) continue;
        if (!narrow(rates, c->joints + r, further(c, r, base), further(c, r, along), c->further_lower[r], c->further_upper[r]))
            return 0;
    }
    if (rates->low > rates->high) { /* at standstill a rounding error of the box must not look like an empty interval */
        if (rates->low - rates->low_slack > rates->high + rates->high_slack) return 0;
        rates->low = rates->high = 0.5 * (rates->low + rates->high);
    }
    if (rates->high < 0.0 && rates->high + rates->high_slack >= 0.0) {
        rates->high = 0.0;
        rates->low = min_of(rates->low, 0.0);
    }
    return 1;
}

/* The fastest rate up to `cap` at which the command stays admissible with full corrections; 0 if no rate is. */
static int search_rate(Core *c, double cap) {
    Rates rates;
    Vector base(c->scratch, c->joints, 1);
    base = c->command - cap * c->along_velocity;
    if (!admissible_rates(c, base, c->along_velocity, ALL_ROWS, &rates)) return 0;
    if (!(rates.high >= max_of(rates.low, 0.0) && rates.low <= 1.0)) return 0;
    const double rate = rates.high < cap ? rates.high : max_of(cap, rates.low);
    c->proposal->binding_row = rates.high < cap ? rates.row : -1;
    c->proposal->binding_side = rates.side;
    c->proposal->new_rate = rate;
    c->command += (rate - cap) * c->along_velocity;
    return clip(c, 2.0 * LIMIT_TOLERANCE) && further_admissible(c, 10.0 * LIMIT_TOLERANCE);
}

/* Which limit makes the bound of joint j on a side: a code of KINDS. */
static LimitKind kind_of(const Core *c, int j, double side, double h) {
    const double limit = side > 0.0 ? c->upper[j] : c->lower[j], tolerance = 1e-9 * (1.0 + fabs(limit));
    if (fabs(fabs(limit) - fastest(c, j, h)) <= tolerance) return VELOCITY;
    if (isfinite(c->acceleration[j])) {
        const double change = (limit - c->velocity[j]) * side;
        if (fabs(fabs(change) - c->acceleration[j] * h) <= tolerance) return ACCELERATION;
    }
    return POSITION;
}

/* 1 if all joints, braking together after this step, stop inside their limits; else the share of their speed that they
 * keep if they brake now. A joint's own distance is not enough: the others may be slower, and they hold one object. */
static double brake_share(const Core *c, double h, int *joint) {
    double longest = 0.0, left = INFINITY;
    for (int j = 0; j < c->joints; j++) longest = max_of(longest, fabs(c->velocity[j]) / c->acceleration[j]);
    if (longest <= 0.0) return 1.0;
    const double planned = longest / BRAKING_SHARE;
    for (int j = 0; j < c->joints; j++) {
        const double v = c->velocity[j], speed = fabs(v), x = c->positions[j];
        const double room = v > 0.0 ? c->high[j] - x : x - c->low[j];
        if (speed * (h + 0.5 * planned) > room && room >= 0.0 && room / speed < left)
            left = room / speed, *joint = j;
    }
    if (left == INFINITY) return 1.0;
    return max_of(0.0, 1.0 - h / min_of(max_of(2.0 * (left - h), longest), planned));
}

static bool stops_at_once(const Core *c, double h) {
    return (c->velocity.array().abs() <= h * c->acceleration.array()).all();
}

static bool any_outside(const Core *c) {
    return (c->positions.array() > c->high.array()).any() || (c->positions.array() < c->low.array()).any();
}
