/* Growth of the horizon: knots as far on as the chain can be followed, one Newton step at a time.
 *
 * It ends at a position limit, at an impassable singularity, at the end of the reach, where a constraint allows no rate,
 * and at the path's end. */

#include "ahead.h"

constexpr double PASSABLE = 0.3; /* a singularity is passed where the rate's cap stays above this share of singular_rate */
constexpr double GROWTH = 2.0; /* an interval is longer than the one before by this factor at most */
constexpr int LONGEST_WAY = 300; /* knots of a way past a singularity */
constexpr double KINK_CELL = 2e-3; /* where an interval this short is too long, a user's path or its twist may jump [s] */
/* A twist by finite differences jumps this much before and after the path, at most [s] */
constexpr double BESIDE_KINK = 2e-5;

/* Growth has come to a pause between two knots. */
static void rest_growth(Core *c) {
    c->ahead->growing = c->ahead->closing_in = false;
    c->ahead->way = 0, c->ahead->seeking = NOT_SEEKING;
    c->ahead->begin_at = INFINITY;
}

/* Half of the way from a knot to the place where a constraint allows no rate, infinite if none is known. */
static double half_way(const Core *c, const Knot *last) {
    return c->ahead->beyond > 0.0 ? 0.5 * (c->ahead->beyond_at - last->clock) : INFINITY;
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
static void block_at(Core *c, int i, int arm, int joint, LimitKind kind) {
    const int count = (int)c->ahead->count;
    copy_knot(c, i, count);
    if (i < count) knot(c, count)->span = 0.0; /* the same knot again */
    knot(c, count)->cap = 0.0;
    name_cause(knot(c, count)->limit, kind, arm, joint);
    push_knot(c);
    rest_growth(c);
}

static void finish_path(Core *c) {
    if (end_moving(c)) push_knot(c);
    finish_horizon(c);
    rest_growth(c);
}

/* Leave at knot `made` the chain where joint j is at `position`, between knots `last` and `made`: regula falsi. */
static Trial close_in(Core *c, int last, int made, int j, double position) {
    double start = knot(c, last)->clock, end = knot(c, made)->clock;
    double miss_start = vector_of(c, c->knot_positions, last)[j] - position;
    double miss_end = vector_of(c, c->knot_positions, made)[j] - position;
    if (miss_start * miss_end >= 0.0) copy_knot(c, last, made); /* it is there already */
    for (int i = 0; i < 8 && miss_start * miss_end < 0.0; i++) {
        const double clock = start - miss_start * (end - start) / (miss_end - miss_start);
        const double span = clock - knot(c, last)->clock;
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
    knot(c, made)->span = knot(c, made)->clock - knot(c, last)->clock;
    block_at(c, made, arm_of(c, joint), joint, POSITION);
    return FOUND;
}

/* How far on from a knot the chain may be followed in one go [s]. */
static double span_after(const Core *c, const Knot *last) {
    const Options *o = c->options;
    const double edge = next_breakpoint(c, last->clock);
    double span = minimum(o->cell, c->duration - last->clock);
    if (last->fastest > 0.0) span = minimum(span, o->joint_step / last->fastest);
    if (last->span > 0.0 && last->corner == 0.0) span = minimum(span, GROWTH * last->span);
    if (last->clock + span > edge - 1e-9) span = edge - last->clock;
    return minimum(span, half_way(c, last));
}

/* Begin the knot after the last known or tentative one. */
static void aim_ahead(Core *c) {
    c->ahead->try_span = span_after(c, knot(c, (int)c->ahead->count + (int)c->ahead->way - 1));
    c->ahead->iteration = c->ahead->sought = 0.0;
    c->ahead->growing = 1.0;
}

/* The chain cannot be followed past the last known knot, or past the singularity that the way leads to. */
static void end_growth(Core *c) {
    const int count = (int)c->ahead->count, way = (int)c->ahead->way > 0, at = way ? count : count - 1;
    const double rate = c->options->singular_rate;
    if (!way && half_way(c, knot(c, at)) < 2.0 * c->options->shortest) {
        block_at(c, at, -1, (int)c->ahead->beyond - 1, CONSTRAINT);
        return;
    }
    const int stretched = way ? -1 : stretched_arm(c, at), arm = stretched < 0 ? singular_arm(c, at) : stretched;
    /* If the last knot is singular, too, the object stays: else it would creep on with every new path. */
    const int stays = way && knot(c, count - 1)->uncapped < rate * rate;
    block_at(c, stays ? count - 1 : at, arm, -1, way ? SINGULARITY : REACH);
}

/* Whether the knot that was tried ends in a singularity, unless there is a way past it. */
static int nears_singularity(const Core *c, int made) {
    const Knot *k = knot(c, made);
    const double rate = c->options->singular_rate;
    return k->uncapped < rate * rate && k->fastest > knot(c, made - 1)->fastest;
}

/* Take the knot that was tried into the way past a singularity. 1 where the joints slow down; 0 where the way goes on,
 * or there is none and growth is over. */
static int go_past(Core *c, int made) {
    const int count = (int)c->ahead->count;
    const double rate = PASSABLE * c->options->singular_rate, end = next_breakpoint(c, knot(c, count)->clock) - 1e-9;
    const Knot *k = knot(c, made);
    const int first = made == count;
    if (!first && (k->inside == 0.0 || k->uncapped < rate * rate || k->clock > end)) {
        end_growth(c);
        return 0;
    }
    c->ahead->way++;
    if (!first && k->fastest < knot(c, made - 1)->fastest) return 1;
    if (c->ahead->way >= LONGEST_WAY || k->clock >= end)
        end_growth(c);
    else
        aim_ahead(c);
    return 0;
}

/* Knots up to the one that was tried are known; 0 if the path, or a constraint, fails. */
static int accept_trial(Core *c) {
    const int last = (int)c->ahead->count - 1, made = last + 1 + (int)c->ahead->way;
    if (made == last + 1 && knot(c, made)->inside == 0.0) {
        const Trial stop = stop_at_limit(c, last, made);
        if (stop != REJECTED) return stop == FOUND;
    }
    if ((made > last + 1 || nears_singularity(c, made)) && !go_past(c, made)) return 1;
    const double edge = next_breakpoint(c, knot(c, last)->clock);
    const int corner = fabs(knot(c, made)->clock - edge) < SAME_CLOCK && edge < c->duration;
    const int found = !corner || turn_corner(c, made);
    for (int i = last; found && i < made; i++) push_knot(c);
    rest_growth(c);
    return found;
}

/* A shorter span is tried. */
static void halve_trial(Core *c) {
    c->ahead->try_span *= 0.5;
    if (!(c->ahead->try_span >= c->options->shortest)) end_growth(c);
}

static void reject_trial(Core *c) {
    c->ahead->iteration = 0.0;
    if (own_path(c) && c->ahead->try_span <= KINK_CELL && c->ahead->way == 0.0)
        c->ahead->seeking = JUMPS;
    else
        halve_trial(c);
}

/* The path's twist jumps at a clock, undeclared: a breakpoint from now on. 0 if the path fails. */
static int take_kink(Core *c, int last, double clock, double kink) {
    int count = (int)c->ahead->kinks;
    if (count == MOST_KINKS) memmove(c->kinks, c->kinks + 1, sizeof(double) * (size_t)--count);
    c->kinks[count++] = kink;
    c->ahead->kinks = count;
    if (kink > clock + SAME_CLOCK) {
        c->ahead->try_span = kink - clock;
        return 1;
    }
    copy_knot(c, last, last + 1); /* the same knot again */
    knot(c, last + 1)->span = 0.0;
    return turn_corner(c, last + 1) && accept_trial(c);
}

/* The first piece of a stage of the search: 1 if it may jump there. */
static int look_for_jump(Core *c, double clock) {
    Ahead *a = c->ahead;
    switch (a->seeking) {
    case JUMPS: return begin_seeking(c, 1, clock, clock + a->try_span);
    case KINKS_OF_TWIST: return begin_seeking(c, 0, maximum(clock - JUST_BEFORE, 0.0), clock + a->try_span);
    default: return begin_seeking(c, 1, a->kink - BESIDE_KINK, a->kink + BESIDE_KINK);
    }
}

/* A piece of the search for what made the tried span too long: a jump of the path, else one of its twist that no jump of
 * the path makes. The span ends there, or is halved. 0 if the path fails. */
static int seek(Core *c) {
    Ahead *a = c->ahead;
    const int last = (int)c->ahead->count - 1, pose = a->seeking != KINKS_OF_TWIST;
    const Seeking stage = a->seeking;
    const double clock = knot(c, last)->clock;
    const int may = a->closing_in != 0.0 ? go_on_seeking(c, pose) : look_for_jump(c, clock);
    a->closing_in = may && seeks_on(c, pose);
    if (a->closing_in != 0.0) return 1;
    const double size = may ? found_by_seeking(c, pose) : 0.0, steep_by = a->steep_by;
    if (pose && size > 0.0 && !(steep_by > 0.0)) {
        a->seek_whole = a->steep_by = size, a->steep_at = a->seek_to;
        a->closing_in = seeks_on(c, pose);
        if (a->closing_in != 0.0) return 1;
    }
    a->seeking = NOT_SEEKING, a->steep_by = 0.0;
    if (pose && may && (size > 0.0 || steep_by > 0.0)) {
        a->jump_at = a->seek_to, a->jump_by = size > 0.0 ? size : -steep_by;
        block_at(c, last, -1, -1, PATH_JUMP);
    } else if (stage == JUMPS && a->sought == 0.0) {
        a->sought = 1.0, a->seeking = KINKS_OF_TWIST;
    } else if (stage == KINKS_OF_TWIST && size > 0.0) {
        a->kink = a->seek_to, a->seeking = BESIDE_A_KINK;
    } else if (stage == BESIDE_A_KINK) {
        return take_kink(c, last, clock, a->kink);
    } else {
        halve_trial(c);
    }
    return 1;
}

static int survey_ahead(Core *c) {
    const int last = (int)c->ahead->count + (int)c->ahead->way - 1;
    if (!c->survey_ahead || last < 0 || c->ahead->growing != 0.0) return 0;
    expect(c, last, span_after(c, knot(c, last)), c->evading_positions.data());
    c->evading_slope = Given(vector_of(c, c->knot_slope, last), c->joints);
    return c->survey_ahead(c);
}

static int work_ahead(Core *c) {
    if (c->ahead->blind != 0.0) return 0;
    const int count = (int)c->ahead->count, made = count + (int)c->ahead->way;
    if (made + 2 + (int)c->ahead->kept > MOST_KNOTS) return 0; /* close_in needs a knot beside the one that is tried */
    if (c->ahead->growing == 0.0) {
        if (!(c->duration - knot(c, count - 1)->clock > 1e-12)) {
            finish_path(c);
            return 1;
        }
        aim_ahead(c);
    }
    if (half_way(c, knot(c, made - 1)) < c->options->shortest) {
        end_growth(c);
        return 1;
    }
    if (c->ahead->seeking != NOT_SEEKING) {
        if (seek(c)) return 1;
        rest_growth(c);
        return -1;
    }
    switch (try_knot(c, made - 1, made, c->ahead->try_span, (int)c->ahead->iteration)) {
    case PENDING: c->ahead->iteration++; return 1;
    case REJECTED:
        if (c->ahead->blind != 0.0) {
            rest_growth(c);
            return 0;
        }
        reject_trial(c);
        return 1;
    case FOUND:
        if (accept_trial(c)) return 1;
        break;
    case CANNOT_SAY: break;
    }
    rest_growth(c);
    return -1;
}
