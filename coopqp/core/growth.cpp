/* Growth of the horizon: grid points as far on as the chain can be followed, one Newton step at a time.
 *
 * It ends at a position limit, at an impassable singularity, at the end of the reach, where a constraint allows no rate,
 * and at the path's end. */

#include "ahead.h"

constexpr double PASSABLE = 0.3; /* a singularity is passed where the rate's cap stays above this share of singular_rate */
constexpr double GROWTH = 2.0; /* an interval is longer than the one before by this factor at most */
constexpr int LONGEST_WAY = 300; /* grid points of a way past a singularity */
constexpr double KINK_CELL = 2e-3; /* where an interval this short is too long, a user's path or its twist may jump [s] */
/* A twist by finite differences jumps this much before and after the path, at most [s] */
constexpr double BESIDE_KINK = 2e-5;

/* Growth has come to a pause between two grid points. */
static void rest_growth(Core *c) {
    c->ahead->growing = c->ahead->closing_in = false;
    c->ahead->passing = 0, c->ahead->seeking = NOT_SEEKING;
    c->ahead->grow_from = INFINITY;
}

/* Half of the way from a grid point to the place where a constraint allows no rate, infinite if none is known. */
static double half_way(const Core *c, const Node *last) {
    return c->ahead->blocked_by > 0 ? 0.5 * (c->ahead->blocked_at - last->clock) : INFINITY;
}

static int singular_arm(const Core *c, int i) {
    const double *slope = vector_of(c, c->node_slope, i);
    double largest = -1.0;
    int fastest = 0;
    for (int j = 0; j < c->joints; j++) {
        const double share = fabs(slope[j]) / (isfinite(c->plan_speed[j]) ? c->plan_speed[j] : 1.0);
        if (share > largest) largest = share, fastest = j;
    }
    return arm_of(c, fastest);
}

/* The object stops at grid point i. */
static void block_at(Core *c, int i, int arm, int joint, LimitKind kind) {
    const int count = c->ahead->count;
    copy_node(c, i, count);
    if (i < count) node(c, count)->span = 0.0; /* the same grid point again */
    node(c, count)->cap = 0.0;
    name_cause(node(c, count)->limit, kind, arm, joint);
    push_node(c);
    rest_growth(c);
}

static void finish_path(Core *c) {
    if (end_moving(c)) push_node(c);
    finish_horizon(c);
    rest_growth(c);
}

/* Leave at grid point `made` the chain where joint j is at `position`, between grid points `last` and `made`: regula falsi. */
static Trial close_in(Core *c, int last, int made, int j, double position) {
    double start = node(c, last)->clock, end = node(c, made)->clock;
    double miss_start = vector_of(c, c->node_positions, last)[j] - position;
    double miss_end = vector_of(c, c->node_positions, made)[j] - position;
    if (miss_start * miss_end >= 0.0) copy_node(c, last, made); /* it is there already */
    for (int i = 0; i < 8 && miss_start * miss_end < 0.0; i++) {
        const double clock = start - miss_start * (end - start) / (miss_end - miss_start);
        const double span = clock - node(c, last)->clock;
        Trial found = PENDING;
        for (int n = 0; found == PENDING && span > 1e-9; n++) found = try_node(c, last, made + 1, span, n);
        if (found == CANNOT_SAY) return CANNOT_SAY;
        if (found == REJECTED) return FOUND;
        copy_node(c, found == FOUND ? made + 1 : last, made);
        const double miss = vector_of(c, c->node_positions, made)[j] - position;
        if (!(fabs(miss) >= 1e-9)) return FOUND;
        if (miss * miss_end > 0.0)
            end = clock, miss_end = miss;
        else
            start = clock, miss_start = miss;
    }
    return FOUND;
}

/* Stop where the first joint meets a position limit between grid points `last` and `made`; rejected if none does. A joint
 * outside may come back in: only going further out is the end. */
static Trial stop_at_limit(Core *c, int last, int made) {
    const double *x = vector_of(c, c->node_positions, last), *ahead = vector_of(c, c->node_positions, made);
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
    node(c, made)->span = node(c, made)->clock - node(c, last)->clock;
    block_at(c, made, arm_of(c, joint), joint, POSITION);
    return FOUND;
}

/* How far on from a grid point the chain may be followed in one go [s]. */
static double span_after(const Core *c, const Node *last) {
    const Options *o = c->options;
    const double edge = next_breakpoint(c, last->clock);
    double span = minimum(o->cell, c->duration - last->clock);
    if (last->fastest > 0.0) span = minimum(span, o->joint_step / last->fastest);
    if (last->span > 0.0 && !last->corner) span = minimum(span, GROWTH * last->span);
    if (last->clock + span > edge - 1e-9) span = edge - last->clock;
    return minimum(span, half_way(c, last));
}

/* Begin the grid point after the last known or tentative one. */
static void aim_ahead(Core *c) {
    c->ahead->trial_span = span_after(c, node(c, c->ahead->count + c->ahead->passing - 1));
    c->ahead->trial_steps = 0, c->ahead->jump_sought = false;
    c->ahead->growing = true;
}

/* The chain cannot be followed past the last known grid point, or past the singularity that the way leads to. */
static void end_growth(Core *c) {
    const int count = c->ahead->count, way = c->ahead->passing > 0, at = way ? count : count - 1;
    const double rate = c->options->singular_rate;
    if (!way && half_way(c, node(c, at)) < 2.0 * c->options->shortest) {
        block_at(c, at, -1, c->ahead->blocked_by - 1, CONSTRAINT);
        return;
    }
    const int stretched = way ? -1 : stretched_arm(c, at), arm = stretched < 0 ? singular_arm(c, at) : stretched;
    /* If the last grid point is singular, too, the object stays: else it would creep on with every new path. */
    const int stays = way && node(c, count - 1)->uncapped < rate * rate;
    block_at(c, stays ? count - 1 : at, arm, -1, way ? SINGULARITY : REACH);
}

/* Whether the grid point that was tried ends in a singularity, unless there is a way past it. */
static int nears_singularity(const Core *c, int made) {
    const Node *k = node(c, made);
    const double rate = c->options->singular_rate;
    return k->uncapped < rate * rate && k->fastest > node(c, made - 1)->fastest;
}

/* Take the grid point that was tried into the way past a singularity. 1 where the joints slow down; 0 where the way goes on,
 * or there is none and growth is over. */
static int go_past(Core *c, int made) {
    const int count = c->ahead->count;
    const double rate = PASSABLE * c->options->singular_rate, end = next_breakpoint(c, node(c, count)->clock) - 1e-9;
    const Node *k = node(c, made);
    const int first = made == count;
    if (!first && (!k->inside || k->uncapped < rate * rate || k->clock > end)) {
        end_growth(c);
        return 0;
    }
    c->ahead->passing++;
    if (!first && k->fastest < node(c, made - 1)->fastest) return 1;
    if (c->ahead->passing >= LONGEST_WAY || k->clock >= end)
        end_growth(c);
    else
        aim_ahead(c);
    return 0;
}

/* Grid points up to the one that was tried are known; 0 if the path, or a constraint, fails. */
static int accept_trial(Core *c) {
    const int last = c->ahead->count - 1, made = last + 1 + c->ahead->passing;
    if (made == last + 1 && !node(c, made)->inside) {
        const Trial stop = stop_at_limit(c, last, made);
        if (stop != REJECTED) return stop == FOUND;
    }
    if ((made > last + 1 || nears_singularity(c, made)) && !go_past(c, made)) return 1;
    const double edge = next_breakpoint(c, node(c, last)->clock);
    const int corner = fabs(node(c, made)->clock - edge) < SAME_CLOCK && edge < c->duration;
    const int found = !corner || turn_corner(c, made);
    for (int i = last; found && i < made; i++) push_node(c);
    rest_growth(c);
    return found;
}

/* A shorter span is tried. */
static void halve_trial(Core *c) {
    c->ahead->trial_span *= 0.5;
    if (!(c->ahead->trial_span >= c->options->shortest)) end_growth(c);
}

static void reject_trial(Core *c) {
    c->ahead->trial_steps = 0;
    if (own_path(c) && c->ahead->trial_span <= KINK_CELL && c->ahead->passing == 0)
        c->ahead->seeking = JUMPS;
    else
        halve_trial(c);
}

/* The path's twist jumps at a clock, undeclared: a breakpoint from now on. 0 if the path fails. */
static int take_kink(Core *c, int last, double clock, double kink) {
    int count = c->ahead->kink_count;
    if (count == MOST_KINKS) memmove(c->kinks, c->kinks + 1, sizeof(double) * (size_t)--count);
    c->kinks[count++] = kink;
    c->ahead->kink_count = count;
    if (kink > clock + SAME_CLOCK) {
        c->ahead->trial_span = kink - clock;
        return 1;
    }
    copy_node(c, last, last + 1); /* the same grid point again */
    node(c, last + 1)->span = 0.0;
    return turn_corner(c, last + 1) && accept_trial(c);
}

/* The first piece of a stage of the search: 1 if it may jump there. */
static int look_for_jump(Core *c, double clock) {
    Ahead *a = c->ahead;
    switch (a->seeking) {
    case JUMPS: return begin_seeking(c, 1, clock, clock + a->trial_span);
    case KINKS_OF_TWIST: return begin_seeking(c, 0, maximum(clock - JUST_BEFORE, 0.0), clock + a->trial_span);
    default: return begin_seeking(c, 1, a->kink_at - BESIDE_KINK, a->kink_at + BESIDE_KINK);
    }
}

/* A piece of the search for what made the tried span too long: a jump of the path, else one of its twist that no jump of
 * the path makes. The span ends there, or is halved. 0 if the path fails. */
static int seek(Core *c) {
    Ahead *a = c->ahead;
    const int last = c->ahead->count - 1, pose = a->seeking != KINKS_OF_TWIST;
    const Seeking stage = a->seeking;
    const double clock = node(c, last)->clock;
    const int may = a->closing_in ? go_on_seeking(c, pose) : look_for_jump(c, clock);
    a->closing_in = may && seeks_on(c, pose);
    if (a->closing_in) return 1;
    const double size = may ? found_by_seeking(c, pose) : 0.0, steep_by = a->steep_by;
    if (pose && size > 0.0 && !(steep_by > 0.0)) {
        a->seek_whole = a->steep_by = size, a->steep_at = a->seek_to;
        a->closing_in = seeks_on(c, pose);
        if (a->closing_in) return 1;
    }
    a->seeking = NOT_SEEKING, a->steep_by = 0.0;
    if (pose && may && (size > 0.0 || steep_by > 0.0)) {
        a->jump_at = a->seek_to, a->jump_by = size > 0.0 ? size : -steep_by;
        block_at(c, last, -1, -1, PATH_JUMP);
    } else if (stage == JUMPS && !a->jump_sought) {
        a->jump_sought = true, a->seeking = KINKS_OF_TWIST;
    } else if (stage == KINKS_OF_TWIST && size > 0.0) {
        a->kink_at = a->seek_to, a->seeking = BESIDE_A_KINK;
    } else if (stage == BESIDE_A_KINK) {
        return take_kink(c, last, clock, a->kink_at);
    } else {
        halve_trial(c);
    }
    return 1;
}

static int survey_ahead(Core *c) {
    const int last = c->ahead->count + c->ahead->passing - 1;
    if (!c->survey_ahead || last < 0 || c->ahead->growing) return 0;
    expect(c, last, span_after(c, node(c, last)), c->evading_positions.data());
    c->evading_slope = Given(vector_of(c, c->node_slope, last), c->joints);
    return c->survey_ahead(c);
}

static int work_ahead(Core *c) {
    if (c->ahead->blind) return 0;
    const int count = c->ahead->count, made = count + c->ahead->passing;
    if (made + 2 + c->ahead->kept > MOST_NODES) return 0; /* close_in needs a grid point beside the one that is tried */
    if (!c->ahead->growing) {
        if (!(c->duration - node(c, count - 1)->clock > 1e-12)) {
            finish_path(c);
            return 1;
        }
        aim_ahead(c);
    }
    if (half_way(c, node(c, made - 1)) < c->options->shortest) {
        end_growth(c);
        return 1;
    }
    if (c->ahead->seeking != NOT_SEEKING) {
        if (seek(c)) return 1;
        rest_growth(c);
        return -1;
    }
    switch (try_node(c, made - 1, made, c->ahead->trial_span, c->ahead->trial_steps)) {
    case PENDING: c->ahead->trial_steps++; return 1;
    case REJECTED:
        if (c->ahead->blind) {
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
