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

#include <algorithm>
#include <array>
#include <map>
#include <utility>
#include <vector>

#include "bounds.h"
#include "spans.h"

/* Pieces of a survey, of so many pairs at least, and at most until there are MOST_PIECES of them; shares of the certificate
 * that are left where a survey begins, and where it is finished at once; a close pair is close no longer beyond this many
 * times the range. */
#define PIECES 6
#define LEAST_PIECE 256
#define LARGE_PIECE 800
#define MOST_PIECES 10
#define SURVEYS_AGAIN 0.5
#define NEARLY_USED 0.02
#define LEAVES 1.2
#define MEASURING 20 /* a pair that is measured counts as so many */

/* A way of the joints, each as far as it moves, and what it takes from clearances by each lever, found when first asked. */
struct Way {
    std::vector<double> joint, taken;
    std::vector<uint64_t> known;
    uint64_t stamp = 1;
    /* The joints' part, to be filled in anew. */
    double *anew() {
        stamp++;
        return joint.data();
    }
};

/* A certificate's weight of each joint, and the least clearance, less what is spared, that was weighed of each lever. */
struct Weights {
    std::vector<double> joint, least;
    void clear() {
        joint.assign(joint.size(), 0.0);
        least.assign(least.size(), INFINITY);
    }
};

/* Reaches of one arm's joints, one after the other: many pairs have the same. */
struct Lever {
    int joint, count, own; /* the first joint, how many, and where their reaches are */
};

struct Survey {
    using Vector = std::vector<double>;
    ptrdiff_t pairs = 0, joints = 0;
    double *clearances = nullptr, *at = nullptr; /* clearances of close pairs hold where the joints are `at` */
    const double *continuous = nullptr, *arm = nullptr; /* of each joint */
    double range = 0.0, spare = 0.0;
    std::vector<Lever> lever;              /* the first one is of nothing */
    Vector own;                            /* reaches of all levers */
    std::vector<std::array<int, 2>> sides; /* levers of each pair, which moves with two arms at most */
    Vector reference, goal; /* the other clearances hold at the goal up to the cursor, and at the reference after it */
    Vector centre, weights; /* the certificate */
    Weights made, all;      /* those of the next one, and of all close pairs */
    Way moved;              /* from the reference to the goal */
    Way way, back;          /* scratch */
    bool known = false, under_way = false;
    ptrdiff_t cursor = 0;
    std::vector<ptrdiff_t> close;
    std::vector<char> is_close;
};

static inline void way_between(const Survey *s, const double *a, const double *b, Way *found) {
    double *way = found->anew();
    for (ptrdiff_t j = 0; j < s->joints; j++) {
        way[j] = fabs(a[j] - b[j]);
        if (s->continuous[j] != 0.0 && fabs(TURN - way[j]) < way[j]) way[j] = fabs(TURN - way[j]);
    }
}

/* The most clearance that a way takes by a lever, and from a pair. */
static inline double taken_by(const Survey *s, size_t l, Way *way) {
    if (way->known[l] == way->stamp) return way->taken[l];
    const Lever lever = s->lever[l];
    const double *own = s->own.data() + lever.own, *joint = way->joint.data() + lever.joint;
    double sum = 0.0;
    for (int i = 0; i < lever.count; i++) sum += own[i] * joint[i];
    way->known[l] = way->stamp;
    return way->taken[l] = sum;
}

static inline double taken(const Survey *s, ptrdiff_t k, Way *way) {
    const std::array<int, 2> sides = s->sides[(size_t)k];
    return taken_by(s, (size_t)sides[0], way) + taken_by(s, (size_t)sides[1], way);
}

/* Each joint's weight becomes at least the pair's reach over its clearance; 0 if there is none beside what is spared. */
static inline bool weigh(const Survey *s, ptrdiff_t k, Weights *weights) {
    const double clearance = s->clearances[k] - s->spare;
    if (!(clearance > 0.0)) return false;
    for (const int l : s->sides[(size_t)k]) {
        if (!(clearance < weights->least[(size_t)l])) continue;
        const Lever lever = s->lever[(size_t)l];
        weights->least[(size_t)l] = clearance;
        for (int i = 0; i < lever.count; i++) {
            double &weight = weights->joint[(size_t)(lever.joint + i)];
            weight = fmax(weight, s->own[(size_t)(lever.own + i)] / clearance);
        }
    }
    return true;
}

/* The sum of weights times a way over the joints of the two arms where it is largest. */
static inline double most_of_two(const Survey *s, const double *weights, const double *way) {
    double first = 0.0, second = 0.0, sum = 0.0;
    for (ptrdiff_t j = 0; j < s->joints; j++) {
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
    way_between(s, x, s->centre.data(), &s->way);
    return left_after(s, s->way.joint.data());
}

static inline void begin_survey(Survey *s, const double *x) {
    s->goal.assign(x, x + s->joints);
    way_between(s, x, s->reference.data(), &s->moved);
    for (size_t l = 0; l < s->lever.size(); l++) taken_by(s, l, &s->moved);
    s->made.clear();
    s->cursor = 0, s->under_way = true;
}

/* Pairs that are far by now leave the close ones, and the certificate is that of the survey. */
static inline void end_survey(Survey *s) {
    ptrdiff_t kept = 0;
    way_between(s, s->at, s->goal.data(), &s->back);
    for (const ptrdiff_t k : s->close) {
        const double clearance = s->clearances[k] - taken(s, k, &s->back);
        if (clearance - s->spare > LEAVES * s->range) {
            s->clearances[k] = clearance, s->is_close[(size_t)k] = 0;
            weigh(s, k, &s->made);
        } else {
            s->close[(size_t)kept++] = k;
        }
    }
    s->close.resize((size_t)kept);
    s->known = true, s->under_way = false;
    s->reference = s->centre = s->goal, s->weights = s->made.joint;
}

/* Look at some more pairs. `measured(k)` is a lower bound of a pair's clearance where the joints are `at`; it is asked for
 * pairs that may be close by now. */
template <typename Measured>
static void go_on(Survey *s, ptrdiff_t pairs, Measured &&measured) {
    const double *moved = s->moved.taken.data(), *least = s->made.least.data(), far = s->range + s->spare;
    way_between(s, s->goal.data(), s->at, &s->back);
    for (; s->cursor < s->pairs && pairs > 0; s->cursor++, pairs--) {
        const ptrdiff_t k = s->cursor;
        if (s->is_close[(size_t)k]) continue;
        const auto [a, b] = s->sides[(size_t)k];
        double &clearance = s->clearances[k];
        clearance -= moved[a] + moved[b];
        if (!(clearance > far)) {
            const double back = taken(s, k, &s->back), here = clearance - back, found = measured(k);
            const double most = found > here ? found : here; /* where the joints are `at` */
            if (most - back > clearance) clearance = most - back;
            pairs -= MEASURING;
            if (!(clearance > far)) {
                clearance = most;
                s->close.push_back(k), s->is_close[(size_t)k] = 1;
                continue;
            }
        }
        const double beside = clearance - s->spare;
        if (beside < least[a] || beside < least[b]) weigh(s, k, &s->made);
    }
    if (s->cursor == s->pairs) end_survey(s);
}

static inline ptrdiff_t piece_of(const Survey *s) {
    const ptrdiff_t most = std::max<ptrdiff_t>(LARGE_PIECE, s->pairs / MOST_PIECES);
    return std::clamp<ptrdiff_t>(s->pairs / PIECES, LEAST_PIECE, most);
}

/* A piece of a survey at x, or half of one, if one is under way, or due because no more than a share is left; whether there
 * was anything to do. */
template <typename Measured>
static bool survey_piece(Survey *s, const double *x, double share, bool shorter, Measured &&measured) {
    if (!s->under_way && left_at(s, x) > share) return false;
    if (!s->under_way) begin_survey(s, x);
    go_on(s, piece_of(s) / (shorter ? 2 : 1), measured);
    return true;
}

/* A whole survey at x. */
template <typename Measured>
static void survey_anew(Survey *s, const double *x, Measured &&measured) {
    const ptrdiff_t every = s->pairs * (1 + MEASURING);
    if (s->under_way) go_on(s, every, measured);
    begin_survey(s, x);
    go_on(s, every, measured);
}

/* A certificate that holds at x, at once if need be. */
template <typename Measured>
static void survey_now(Survey *s, const double *x, Measured &&measured) {
    if (left_at(s, x) > NEARLY_USED) return;
    if (s->under_way) go_on(s, s->pairs * (1 + MEASURING), measured);
    if (left_at(s, x) <= NEARLY_USED) survey_anew(s, x, measured);
}

/* All clearances hold where the joints are `at`. */
static inline void start_survey(Survey *s) {
    s->is_close.assign((size_t)s->pairs, 0);
    s->reference.assign(s->at, s->at + s->joints);
    s->close.clear(), s->known = s->under_way = false;
}

/* The joints are at x: close pairs lose the most clearance that this way can take. */
static inline void follow_close(Survey *s, const double *x) {
    way_between(s, x, s->at, &s->way);
    for (const ptrdiff_t k : s->close) s->clearances[k] -= taken(s, k, &s->way);
    memcpy(s->at, x, sizeof(double) * (size_t)s->joints);
}

/* Weights about where the joints are `at` that hold for all pairs; 0 where nothing is known. */
static inline bool certify_all(Survey *s, double *weights) {
    const double left = left_at(s, s->at);
    if (!(left > 0.0)) return false;
    s->all.clear();
    for (const ptrdiff_t k : s->close)
        if (!weigh(s, k, &s->all)) return false;
    for (size_t j = 0; j < (size_t)s->joints; j++) weights[j] = fmax(s->weights[j] / left, s->all.joint[j]);
    return true;
}

/* Over memory for clearances and joints, with reaches (joints, pairs). */
static inline void build_survey(Survey *s, ptrdiff_t pairs, ptrdiff_t joints, double *clearances, double *at,
                                const double *reach, const double *continuous, const double *arm) {
    using Reaches = std::vector<double>;
    std::map<std::pair<ptrdiff_t, Reaches>, int> levers;
    s->pairs = pairs, s->joints = joints, s->clearances = clearances, s->at = at;
    s->continuous = continuous, s->arm = arm;
    s->lever.assign(1, Lever{});
    for (ptrdiff_t k = 0; k < pairs; k++) {
        std::array<int, 2> sides = {0, 0};
        int count = 0;
        for (ptrdiff_t begin = 0, end; begin < joints; begin = end) {
            ptrdiff_t first = -1, last = -1;
            for (end = begin; end < joints && arm[end] == arm[begin]; end++)
                if (reach[end * pairs + k] != 0.0) first = first < 0 ? end : first, last = end;
            if (first < 0) continue;
            Reaches own;
            for (ptrdiff_t j = first; j <= last; j++) own.push_back(reach[j * pairs + k]);
            const auto [found, is_new] = levers.emplace(std::pair(first, own), (int)s->lever.size());
            check_fit(count < 2, "a pair moves with two arms at most");
            sides[count++] = found->second;
            if (!is_new) continue;
            s->lever.push_back(Lever{(int)first, (int)own.size(), (int)s->own.size()});
            s->own.insert(s->own.end(), own.begin(), own.end());
        }
        s->sides.push_back(sides);
    }
    const size_t all = s->lever.size();
    for (Survey::Vector *own : {&s->reference, &s->goal, &s->centre, &s->weights, &s->made.joint, &s->all.joint,
                                &s->moved.joint, &s->way.joint, &s->back.joint})
        own->assign((size_t)joints, 0.0);
    for (Way *way : {&s->moved, &s->way, &s->back}) way->taken.resize(all), way->known.resize(all);
    for (Weights *weights : {&s->made, &s->all}) weights->least.resize(all);
    s->is_close.assign((size_t)pairs, 0);
    s->close.reserve((size_t)pairs);
}

#endif
