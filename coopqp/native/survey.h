/* Lower bounds of the distances of many pairs, of which a step touches few.
 *
 * A pair within `range` of its margin is close: its clearance follows every step. All others together have one certificate:
 * where the sum of weights |x - centre| is at most 1 over the joints of any two arms, each of them keeps its margin and
 * `spare` besides: no pair moves with more arms. A survey makes the certificate anew, some pairs in each step. The plain
 * form, LowerBounds in distances.py, follows all pairs. */

#ifndef COOPQP_SURVEY_H
#define COOPQP_SURVEY_H

#include <math.h>
#include <string.h>

#include <vector>

#include "bounds.h"

/* Pairs that one piece of a survey looks at, and the largest number of pieces; shares of the certificate that are left where a survey begins, and where
 * it is finished at once; a close pair is close no longer beyond this many times the range. */
#define PIECE 256
#define PIECES 10
#define SURVEYS_AGAIN 0.5
#define NEARLY_USED 0.02
#define LEAVES 1.2

struct Survey {
    using Vector = std::vector<double>;
    Py_ssize_t pairs = 0, joints = 0;
    double *clearances = nullptr, *at = nullptr; /* clearances of close pairs hold where the joints are `at` */
    const double *continuous = nullptr, *arm = nullptr; /* of each joint */
    double range = 0.0, spare = 0.0;
    std::vector<Py_ssize_t> first, joint; /* entries of each pair: joints that move it, and its reach from them */
    Vector own;
    Vector reference, goal; /* the other clearances hold at the goal up to the cursor, and at the reference after it */
    Vector centre, weights, made; /* the certificate, and the weights of the next one */
    Vector way, back;             /* scratch */
    bool known = false, under_way = false;
    Py_ssize_t cursor = 0;
    std::vector<Py_ssize_t> close;
    std::vector<char> is_close;
};

static inline void way_between(const Survey *s, const double *a, const double *b, double *way) {
    for (Py_ssize_t j = 0; j < s->joints; j++) {
        way[j] = fabs(a[j] - b[j]);
        if (s->continuous[j] != 0.0 && fabs(TURN - way[j]) < way[j]) way[j] = fabs(TURN - way[j]);
    }
}

/* The most clearance that a way takes from a pair. */
static inline double taken(const Survey *s, Py_ssize_t k, const double *way) {
    double most[4] = {0}; /* sums that do not wait for each other */
    const double *own = s->own.data();
    const Py_ssize_t *joint = s->joint.data(), end = s->first[(size_t)k + 1];
    Py_ssize_t i = s->first[(size_t)k];
    for (; i + 4 <= end; i += 4)
        for (int n = 0; n < 4; n++) most[n] += own[i + n] * way[joint[i + n]];
    for (; i < end; i++) most[0] += own[i] * way[joint[i]];
    return (most[0] + most[1]) + (most[2] + most[3]);
}

/* Each joint's weight becomes at least the pair's reach over its clearance; 0 if there is none beside what is spared. */
static inline bool weigh(const Survey *s, Py_ssize_t k, double *weights) {
    const double clearance = s->clearances[k] - s->spare, *own = s->own.data();
    const Py_ssize_t *joint = s->joint.data(), end = s->first[(size_t)k + 1];
    if (!(clearance > 0.0)) return false;
    for (Py_ssize_t i = s->first[(size_t)k]; i < end; i++)
        if (own[i] > weights[joint[i]] * clearance) weights[joint[i]] = own[i] / clearance;
    return true;
}

/* The sum of weights times a way over the joints of the two arms where it is largest. */
static inline double most_of_two(const Survey *s, const double *weights, const double *way) {
    double first = 0.0, second = 0.0, sum = 0.0;
    for (Py_ssize_t j = 0; j < s->joints; j++) {
        sum += weights[j] * way[j];
        if (j + 1 < s->joints && s->arm[j + 1] == s->arm[j]) continue;
        if (sum > first) second = first, first = sum;
        else if (sum > second) second = sum;
        sum = 0.0;
    }
    return first + second;
}

/* What is left of the certificate of the others after a way; negative if there is none. */
static inline double left_after(const Survey *s, const double *way) {
    return (s->known ? 1.0 : -1.0) - most_of_two(s, s->weights.data(), way);
}

static inline double left_at(Survey *s, const double *x) {
    way_between(s, x, s->centre.data(), s->way.data());
    return left_after(s, s->way.data());
}

static inline void begin_survey(Survey *s, const double *x) {
    s->goal.assign(x, x + s->joints);
    s->made.assign((size_t)s->joints, 0.0);
    s->cursor = 0, s->under_way = true;
}

/* Pairs that are far by now leave the close ones, and the certificate is that of the survey. */
static inline void end_survey(Survey *s) {
    Py_ssize_t kept = 0;
    way_between(s, s->at, s->goal.data(), s->back.data());
    for (const Py_ssize_t k : s->close) {
        const double clearance = s->clearances[k] - taken(s, k, s->back.data());
        if (clearance - s->spare > LEAVES * s->range) {
            s->clearances[k] = clearance, s->is_close[(size_t)k] = 0;
            weigh(s, k, s->made.data());
        } else {
            s->close[(size_t)kept++] = k;
        }
    }
    s->close.resize((size_t)kept);
    s->known = true, s->under_way = false;
    s->reference = s->centre = s->goal, s->weights = s->made;
}

/* Look at some more pairs. */
static inline void go_on(Survey *s, Py_ssize_t pairs) {
    const Py_ssize_t end = s->pairs - s->cursor < pairs ? s->pairs : s->cursor + pairs;
    way_between(s, s->goal.data(), s->reference.data(), s->way.data());
    way_between(s, s->goal.data(), s->at, s->back.data());
    for (; s->cursor < end; s->cursor++) {
        const Py_ssize_t k = s->cursor;
        if (s->is_close[(size_t)k]) continue;
        s->clearances[k] -= taken(s, k, s->way.data());
        if (s->clearances[k] - s->spare > s->range) {
            weigh(s, k, s->made.data());
        } else {
            s->clearances[k] -= taken(s, k, s->back.data());
            s->close.push_back(k), s->is_close[(size_t)k] = 1;
        }
    }
    if (s->cursor == s->pairs) end_survey(s);
}

/* A piece of a survey at x, if one is under way or due; whether there was anything to do. */
static inline bool survey_piece(Survey *s, const double *x) {
    if (!s->under_way && left_at(s, x) > SURVEYS_AGAIN) return false;
    if (!s->under_way) begin_survey(s, x);
    go_on(s, s->pairs / PIECES > PIECE ? s->pairs / PIECES : PIECE);
    return true;
}

/* A whole survey at x. */
static inline void survey_anew(Survey *s, const double *x) {
    if (s->under_way) go_on(s, s->pairs);
    begin_survey(s, x);
    go_on(s, s->pairs);
}

/* A certificate that holds at x, at once if need be. */
static inline void survey_now(Survey *s, const double *x) {
    if (left_at(s, x) > NEARLY_USED) return;
    if (s->under_way) go_on(s, s->pairs);
    if (left_at(s, x) <= NEARLY_USED) survey_anew(s, x);
}

/* All clearances hold where the joints are `at`. */
static inline void start_survey(Survey *s) {
    s->is_close.assign((size_t)s->pairs, 0);
    s->reference.assign(s->at, s->at + s->joints);
    s->close.clear(), s->known = s->under_way = false;
}

/* The joints are at x: close pairs lose the most clearance that this way can take. */
static inline void follow_close(Survey *s, const double *x) {
    way_between(s, x, s->at, s->way.data());
    for (const Py_ssize_t k : s->close) s->clearances[k] -= taken(s, k, s->way.data());
    memcpy(s->at, x, sizeof(double) * (size_t)s->joints);
}

/* Weights about where the joints are `at` that hold for all pairs; 0 where nothing is known. */
static inline bool certify_all(Survey *s, double *weights) {
    const double left = left_at(s, s->at);
    if (!(left > 0.0)) return false;
    for (Py_ssize_t j = 0; j < s->joints; j++) weights[j] = s->weights[(size_t)j] / left;
    for (const Py_ssize_t k : s->close)
        if (!weigh(s, k, weights)) return false;
    return true;
}

/* Over memory for clearances and joints, with reaches (joints, pairs). */
static inline void build_survey(Survey *s, Py_ssize_t pairs, Py_ssize_t joints, double *clearances, double *at,
                                const double *reach, const double *continuous, const double *arm) {
    s->pairs = pairs, s->joints = joints, s->clearances = clearances, s->at = at;
    s->continuous = continuous, s->arm = arm;
    for (Survey::Vector *own : {&s->reference, &s->goal, &s->centre, &s->weights, &s->made, &s->way, &s->back})
        own->assign((size_t)joints, 0.0);
    s->is_close.assign((size_t)pairs, 0);
    s->close.reserve((size_t)pairs);
    s->first.assign(1, 0);
    for (Py_ssize_t k = 0; k < pairs; k++) {
        for (Py_ssize_t j = 0; j < joints; j++)
            if (reach[j * pairs + k] != 0.0) s->joint.push_back(j), s->own.push_back(reach[j * pairs + k]);
        s->first.push_back((Py_ssize_t)s->joint.size());
    }
}

#endif
