/* Lower bounds of the distances of many pairs, of which a step touches few.
 *
 * A pair within `range` of its margin is close: its room follows every step. All others together have one certificate:
 * where the sum of weights |x - centre| is at most 1 over the joints of any two arms, each of them keeps its margin and
 * `spare` besides: no pair moves with more arms. A survey makes the certificate anew, some pairs in each step. The plain
 * form, LowerBounds in distances.py, follows all pairs. */

#ifndef COOPQP_SURVEY_H
#define COOPQP_SURVEY_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bounds.h"

/* Pairs that one piece of a survey looks at, and the largest number of pieces; shares of the certificate that are left where a survey begins, and where
 * it is finished at once; a close pair is close no longer beyond this many times the range. */
#define PIECE 256
#define PIECES 10
#define SURVEYS_AGAIN 0.5
#define NEARLY_USED 0.02
#define LEAVES 1.2

struct Survey {
    Py_ssize_t pairs, joints;
    double *rooms, *at;             /* the rooms of close pairs hold where the joints are `at` */
    const double *continuous, *arm; /* of each joint */
    double range, spare;
    Py_ssize_t *first, *joint;      /* entries of each pair: joints that move it, and its reach from them */
    double *own;
    double *reference, *goal;       /* the other rooms hold at the goal up to the cursor, and at the reference after it */
    double *centre, *weights, *made; /* the certificate, and the weights of the next one */
    double *way, *back;             /* scratch */
    int known, under_way;
    Py_ssize_t cursor, *close, closes;
    char *is_close;
};

static inline void way_between(const Survey *s, const double *a, const double *b, double *way) {
    for (Py_ssize_t j = 0; j < s->joints; j++) {
        way[j] = fabs(a[j] - b[j]);
        if (s->continuous[j] != 0.0 && fabs(TURN - way[j]) < way[j]) way[j] = fabs(TURN - way[j]);
    }
}

/* The most room that a way takes from a pair. */
static inline double taken(const Survey *s, Py_ssize_t k, const double *way) {
    double most[4] = {0}; /* sums that do not wait for each other */
    const Py_ssize_t end = s->first[k + 1];
    Py_ssize_t i = s->first[k];
    for (; i + 4 <= end; i += 4)
        for (int n = 0; n < 4; n++) most[n] += s->own[i + n] * way[s->joint[i + n]];
    for (; i < end; i++) most[0] += s->own[i] * way[s->joint[i]];
    return (most[0] + most[1]) + (most[2] + most[3]);
}

/* Each joint's weight becomes at least the pair's reach over its room; 0 if there is none beside what is spared. */
static inline int weigh(const Survey *s, Py_ssize_t k, double *weights) {
    const double room = s->rooms[k] - s->spare;
    if (!(room > 0.0)) return 0;
    for (Py_ssize_t i = s->first[k]; i < s->first[k + 1]; i++)
        if (s->own[i] > weights[s->joint[i]] * room) weights[s->joint[i]] = s->own[i] / room;
    return 1;
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
    return (s->known ? 1.0 : -1.0) - most_of_two(s, s->weights, way);
}

static inline double left_at(Survey *s, const double *x) {
    way_between(s, x, s->centre, s->way);
    return left_after(s, s->way);
}

static inline void begin_survey(Survey *s, const double *x) {
    memcpy(s->goal, x, sizeof(double) * (size_t)s->joints);
    memset(s->made, 0, sizeof(double) * (size_t)s->joints);
    s->cursor = 0, s->under_way = 1;
}

/* Pairs that are far by now leave the close ones, and the certificate is that of the survey. */
static inline void end_survey(Survey *s) {
    Py_ssize_t kept = 0;
    way_between(s, s->at, s->goal, s->back);
    for (Py_ssize_t i = 0; i < s->closes; i++) {
        const Py_ssize_t k = s->close[i];
        const double room = s->rooms[k] - taken(s, k, s->back);
        if (room - s->spare > LEAVES * s->range) {
            s->rooms[k] = room, s->is_close[k] = 0;
            weigh(s, k, s->made);
        } else {
            s->close[kept++] = k;
        }
    }
    s->closes = kept, s->known = 1, s->under_way = 0;
    memcpy(s->reference, s->goal, sizeof(double) * (size_t)s->joints);
    memcpy(s->centre, s->goal, sizeof(double) * (size_t)s->joints);
    memcpy(s->weights, s->made, sizeof(double) * (size_t)s->joints);
}

/* Look at some more pairs. */
static inline void go_on(Survey *s, Py_ssize_t pairs) {
    const Py_ssize_t end = s->pairs - s->cursor < pairs ? s->pairs : s->cursor + pairs;
    way_between(s, s->goal, s->reference, s->way);
    way_between(s, s->goal, s->at, s->back);
    for (; s->cursor < end; s->cursor++) {
        const Py_ssize_t k = s->cursor;
        if (s->is_close[k]) continue;
        s->rooms[k] -= taken(s, k, s->way);
        if (s->rooms[k] - s->spare > s->range) {
            weigh(s, k, s->made);
        } else {
            s->rooms[k] -= taken(s, k, s->back);
            s->close[s->closes++] = k, s->is_close[k] = 1;
        }
    }
    if (s->cursor == s->pairs) end_survey(s);
}

/* A piece of a survey at x, if one is under way or due; whether there was anything to do. */
static inline int survey_piece(Survey *s, const double *x) {
    if (!s->under_way && left_at(s, x) > SURVEYS_AGAIN) return 0;
    if (!s->under_way) begin_survey(s, x);
    go_on(s, s->pairs / PIECES > PIECE ? s->pairs / PIECES : PIECE);
    return 1;
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

/* All rooms hold where the joints are `at`. */
static inline void start_survey(Survey *s) {
    memset(s->is_close, 0, (size_t)s->pairs);
    memcpy(s->reference, s->at, sizeof(double) * (size_t)s->joints);
    s->closes = 0, s->known = s->under_way = 0;
}

/* The joints are at x: close pairs lose the most room that this way can take. */
static inline void follow_close(Survey *s, const double *x) {
    way_between(s, x, s->at, s->way);
    for (Py_ssize_t i = 0; i < s->closes; i++) s->rooms[s->close[i]] -= taken(s, s->close[i], s->way);
    memcpy(s->at, x, sizeof(double) * (size_t)s->joints);
}

/* Weights about where the joints are `at` that hold for all pairs; 0 where nothing is known. */
static inline int certify_all(Survey *s, double *weights) {
    const double left = left_at(s, s->at);
    if (!(left > 0.0)) return 0;
    for (Py_ssize_t j = 0; j < s->joints; j++) weights[j] = s->weights[j] / left;
    for (Py_ssize_t i = 0; i < s->closes; i++)
        if (!weigh(s, s->close[i], weights)) return 0;
    return 1;
}

static inline void free_survey(Survey *s) {
    void *own[] = {s->first, s->joint, s->own, s->reference, s->goal, s->centre, s->weights, s->made,
                   s->way,   s->back,  s->close, s->is_close};
    for (size_t i = 0; i < sizeof own / sizeof *own; i++) free(own[i]);
}

/* Memory of zeros for so many and one more; 0 without memory. */
template <typename T>
static int allocate(T *&out, Py_ssize_t count) {
    return (out = static_cast<T *>(calloc((size_t)count + 1, sizeof(T)))) != nullptr;
}

/* Over memory for rooms and joints, with reaches (joints, pairs); 0 without memory. */
static inline int build_survey(Survey *s, Py_ssize_t pairs, Py_ssize_t joints, double *rooms, double *at, const double *reach,
                               const double *continuous, const double *arm) {
    Py_ssize_t entries = 0;
    for (Py_ssize_t i = 0; i < pairs * joints; i++) entries += reach[i] != 0.0;
    double **vectors[] = {&s->reference, &s->goal, &s->centre, &s->weights, &s->made, &s->way, &s->back};
    int good = 1;
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        good = allocate(*vectors[i], joints) && good;
    good = good && allocate(s->first, pairs) && allocate(s->joint, entries) && allocate(s->own, entries);
    if (!good || !allocate(s->close, pairs) || !allocate(s->is_close, pairs)) return 0;
    s->pairs = pairs, s->joints = joints, s->rooms = rooms, s->at = at, s->continuous = continuous, s->arm = arm, entries = 0;
    for (Py_ssize_t k = 0; k < pairs; k++) {
        for (Py_ssize_t j = 0; j < joints; j++)
            if (reach[j * pairs + k] != 0.0) s->joint[entries] = j, s->own[entries++] = reach[j * pairs + k];
        s->first[k + 1] = entries;
    }
    return 1;
}

#endif
