/* See nearby.h. */

#include "nearby.h"

#include <math.h>
#include <string.h>

#include <algorithm>
#include <utility>

#include "core.h"

/* A pair is followed by itself within this of its margin, others all together [m]. */
#define FOLLOWED 0.25
/* Pairs whose bounds are made sharp in a step, and ahead of need; gaps that are found ahead of need; where there are more
 * pairs than this, surveys and other work share steps. A share of the distance that is sharp, and one that is where only
 * more than enough is asked for. */
#define MOST_SHARPENED 3
#define SHARPENED_EARLY 5
#define SHARPENED_AT_START 100
#define GAPS_EARLY 4
#define MANY_PAIRS 8000
#define SHARP 1e-4
#define ROUGH 0.02
/* The share of a certificate that is used when the next is begun; where less than NEEDED of the certificate of what is far
 * is left, the survey goes first. Pairs are looked at ahead of a grid point this far beyond the motion to it. */
#define USED 0.5
#define NEEDED 0.25
#define MOST_NEEDED 0.9
#define WIDER 1.3

/* -- shapes ---------------------------------------------------------------------------------------------------------- */

Shapes::Shapes(Read axes, Read carriers, Read shapes, const std::vector<Read> &corners, Read pairs) {
    enum { KIND, JOINT, HALF, RADIUS = HALF + 3, PLACE, NUMBERS = PLACE + 12 };
    const size_t count = corners.size(), n = (size_t)carriers.size;
    check_fit(axes.size == 6 * carriers.size && (size_t)shapes.size == NUMBERS * count && pairs.size % 2 == 0);
    joint.resize(n), shape.resize(count), stamps.resize(count), x.resize(n);
    for (size_t j = 0; j < n; j++) {
        joint[j].moment = Eigen::Map<const Vector3>(axes.data + 6 * j);
        joint[j].axis = Eigen::Map<const Vector3>(axes.data + 6 * j + 3);
        check_fit(carriers.data[j] >= -1.0 && carriers.data[j] < (double)j);
        joint[j].carrier = (int)carriers.data[j];
    }
    for (size_t i = 0; i < count; i++) {
        const double *numbers = shapes.data + NUMBERS * i;
        Shape &s = shape[i];
        check_fit(numbers[JOINT] >= -1.0 && numbers[JOINT] < (double)n && numbers[KIND] >= BOX && numbers[KIND] <= HULL);
        s.kind = (int)numbers[KIND], s.joint = (int)numbers[JOINT], s.radius = numbers[RADIUS];
        s.half = Eigen::Map<const Vector3>(numbers + HALF);
        s.at_zero = s.T = *reinterpret_cast<const Pose *>(numbers + PLACE);
        s.corners.assign(corners[i].data, corners[i].data + corners[i].size);
        check_fit(s.corners.size() % 3 == 0 && (s.kind != HULL || !s.corners.empty()));
    }
    for (ptrdiff_t i = 0; i < pairs.size; i++) {
        check_fit(pairs.data[i] >= 0.0 && pairs.data[i] < (double)count);
        (i % 2 ? second : first).push_back((int)pairs.data[i]);
    }
    ways.assign(first.size(), Vector3::UnitX());
}

void Shapes::place(const double *positions) {
    if (memcmp(x.data(), positions, sizeof(double) * x.size()) == 0) return;
    x.assign(positions, positions + x.size());
    stamp++;
}

/* Where a joint takes what stands at zero positions: p = (1 − R) c about its axis through c, or x along it. */
const Shapes::Joint &Shapes::placed_joint(int j) {
    static const Joint world = {{}, {}, {Matrix3::Identity(), Vector3::Zero()}, {}, -1, 0};
    if (j < 0) return world;
    Joint &own = joint[(size_t)j];
    if (own.stamp == stamp) return own;
    const Joint &before = placed_joint(own.carrier);
    const double at = x[(size_t)j];
    Pose moved = {Matrix3::Identity(), at * own.moment};
    if (own.axis.squaredNorm() > 0.5) {
        const Vector3 c = own.axis.cross(own.moment);
        moved.R = exp3(at * own.axis);
        moved.p = c - moved.R * c;
    }
    own.T = compose(before.T, moved);
    own.twist = both(before.T.R * own.moment, before.T.R * own.axis);
    own.twist.head<3>() += before.T.p.cross(own.twist.tail<3>());
    own.stamp = stamp;
    return own;
}

const Shape &Shapes::placed(size_t i) {
    Shape &s = shape[i];
    if (stamps[i] == stamp || s.joint < 0) return s;
    s.T = compose(placed_joint(s.joint).T, s.at_zero);
    stamps[i] = stamp;
    return s;
}

double Shapes::bound(ptrdiff_t k, double enough, double tolerance) {
    const Shape &a = placed((size_t)first[(size_t)k]), &b = placed((size_t)second[(size_t)k]);
    return least_gap(a, b, ways[(size_t)k], enough, tolerance, nullptr);
}

double Shapes::bound_at(ptrdiff_t k, const Pose &T, double tolerance) {
    const size_t i = (size_t)first[(size_t)k], j = (size_t)second[(size_t)k], held = shape[i].joint < 0 ? j : i;
    shape[held].T = T, stamps[held] = 0;
    return least_gap(shape[i], shape[j], ways[(size_t)k], INFINITY, tolerance, nullptr);
}

double Shapes::gap(ptrdiff_t k, double *ends) {
    const Shape &a = placed((size_t)first[(size_t)k]), &b = placed((size_t)second[(size_t)k]);
    Vector3 &way = ways[(size_t)k], point;
    const double apart = (b.T.p - a.T.p).norm(); /* an answer does not depend on those before */
    way = apart > CORES_TOUCH ? Vector3((b.T.p - a.T.p) / apart) : Vector3::UnitX();
    const double found = least_gap(a, b, way, INFINITY, GJK_SHARE, &point);
    Twist(ends, 6, 1) = both(way, point);
    return found;
}

/* -- building -------------------------------------------------------------------------------------------------------- */

Nearby::Nearby(const NearbyArrays &arrays, const Settings &settings, std::unique_ptr<ExactDistances> exact_given,
               Shapes &&shapes_given)
    : NearbyArrays(arrays), set(settings), exact(std::move(exact_given)), shapes(std::move(shapes_given)),
      pairs((ptrdiff_t)shapes.pairs()), joints((ptrdiff_t)shapes.joints()) {
    const ptrdiff_t P = pairs, nv = joints;
    check_fit(exact->pairs() == (size_t)P && nv > 0 && node_positions.size % nv == 0);
#define FITS(name, numbers) check_fit(name.size == (numbers));
    NEARBY_ARRAYS(FITS, FITS)
#undef FITS
    const size_t own = (size_t)nv;
    next.resize(own), coming.resize(own), watch.resize((size_t)P), sharp.resize((size_t)P);
    build_survey(&survey, P, nv, clearances.data, at.data, reach.data, continuous.data, arm.data);
    survey.range = FOLLOWED, survey.spare = set.spare;
    motion = survey.way;
    start_survey(&survey);
}

void Nearby::placement(Read x, ptrdiff_t i, Write found) {
    check_fit(x.size == joints && found.size == 12 && i >= 0 && (size_t)i < shapes.size());
    shapes.place(x.data);
    *reinterpret_cast<Pose *>(found.data) = shapes.placed((size_t)i).T;
}

double Nearby::bound(Read x, ptrdiff_t k) {
    check_fit(x.size == joints && k >= 0 && k < pairs);
    shapes.place(x.data);
    return shapes.bound(k, INFINITY, SHARP);
}

/* -- clearances ------------------------------------------------------------------------------------------------------ */

/* The joints are at x: clearances of close pairs are those there. */
void Nearby::follow(const double *x) {
    if (memcmp(x, at.data, sizeof(double) * (size_t)joints) == 0) return;
    sharp_stamp++;
    follow_close(&survey, x);
}

/* Clearance of a close pair at x, where the joints are followed to, as sharp as needed: `enough`, or by tolerance. */
double Nearby::bounded(ptrdiff_t k, const double *x, double enough, double tolerance) {
    double &own = clearances.data[k];
    if (own >= enough || is_sharp(k)) return own;
    shapes.place(x);
    own = maximum(own, shapes.bound(k, enough + margins.data[k], tolerance) - margins.data[k]);
    if (own < enough && tolerance <= SHARP) sharp[(size_t)k] = sharp_stamp;
    return own;
}

/* A rough bound of a clearance where close pairs are followed to. */
double Nearby::Measured::operator()(ptrdiff_t k) const {
    all->shapes.place(all->at.data);
    return all->shapes.bound(k, INFINITY, ROUGH) - all->margins.data[k];
}

/* The same by exact-> */
double Nearby::asked(ptrdiff_t k, const double *x) {
    exact->place(x);
    sharp[(size_t)k] = sharp_stamp;
    return clearances.data[k] = exact->distance(k) - margins.data[k];
}

/* -- rows ------------------------------------------------------------------------------------------------------------ */

double Nearby::approach_of(bool blind) const {
    return blind ? minimum(1.0 / dt.data[0], set.approach) : 1.0 / dt.data[0];
}

/* Pairs are asked within this of their margin: nothing else can reach it at full speed. */
void Nearby::set_watches(double rate, double range) {
    if (watch_of[0] == rate && watch_of[1] == range) return;
    double widest = 0.0;
    watch_of[0] = rate, watch_of[1] = range;
    for (ptrdiff_t k = 0; k < pairs; k++) {
        watch[(size_t)k] = minimum(range, fastest.data[k] / rate);
        widest = maximum(widest, watch[(size_t)k]);
    }
    if (!(widest > survey.range)) return;
    survey.range = widest;
    survey_anew(&survey, positions.data, measured);
}

/* What rows and clear begin with. */
void Nearby::begin(bool blind) {
    job = IDLE;
    set_watches(approach_of(blind), blind ? WATCHED_BLIND : WATCHED);
    survey_now(&survey, positions.data, measured);
    follow(positions.data);
}

/* Pairs within their watch, asked, in their order: how many; none if they are too many. */
std::optional<size_t> Nearby::find_near() {
    near.clear();
    for (const ptrdiff_t k : survey.close) {
        const double within = watch[(size_t)k];
        if (bounded(k, positions.data, within, SHARP) < within && asked(k, positions.data) < within) near.push_back(k);
    }
    std::sort(near.begin(), near.end());
    if ((double)near.size() > set.most_pairs || (ptrdiff_t)near.size() > lower.size) return {};
    return near.size();
}

/* The close pair whose clearance may be used up first; -1 of none. */
ptrdiff_t Nearby::soonest_close() const {
    double share = -1.0;
    ptrdiff_t found = -1;
    for (const ptrdiff_t k : survey.close) {
        const double left = maximum(LEAST_CLEARANCE, clearances.data[k] - survey.spare);
        if (most.data[k] > share * left) share = most.data[k] / left, found = k;
    }
    return found;
}

/* Sharpen bounds of close pairs, a few in a step, until that of the one that may use up its clearance first is sharp. */
void Nearby::sharpen(int count) {
    for (int i = 0; i < count; i++) {
        const ptrdiff_t k = soonest_close();
        if (k < 0 || is_sharp(k)) return;
        bounded(k, at.data, INFINITY, SHARP);
    }
}

/* Say about which positions nothing binds, as far as distances are known. */
void Nearby::put_certificate() {
    memcpy(centre.data, at.data, sizeof(double) * (size_t)joints);
    slack.data[0] = certify_all(&survey, weights.data) ? 1.0 : -1.0;
}

long Nearby::rows(bool blind) {
    const double rate = approach_of(blind);
    which.clear();
    begin(blind);
    if (!find_near())
        throw std::overflow_error("more pairs are near than a step has rows for");
    sharpen(MOST_SHARPENED);
    for (const ptrdiff_t k : near) { /* those that joints at full speed cannot break are left out */
        const size_t m = which.size();
        double ends[6], *row = G.data + (ptrdiff_t)m * joints;
        exact->ends(k, ends);
        gradient(ends, jacobian.data, kinds.data + k * joints, row, joints);
        lower.data[m] = least_speed(clearances.data[k], rate);
        if (!breakable(row, lower.data[m], speeds.data, joints)) continue;
        upper.data[m] = INFINITY, soft.data[m] = 1.0, owner.data[m] = (double)k;
        which.push_back(k);
    }
    put_certificate();
    approach.data[0] = blind ? set.approach : INFINITY;
    counts.data[0] += 1.0, counts.data[1] = (double)which.size(); /* what fails is counted in Python */
    return (long)which.size();
}

/* Whether the way leaves every pair outside its margin. */
bool Nearby::way_is_clear(const double *x) {
    if (!(left_at(&survey, x) > most_of_two(&survey, survey.weights.data(), motion.joint.data()))) return false;
    for (const ptrdiff_t k : survey.close) {
        const double need = taken(&survey, k, &motion);
        if (clearances.data[k] > need) continue;
        if (!(bounded(k, x, 2.0 * need, ROUGH) > need) && !(bounded(k, x, 2.0 * need, SHARP) > need)) return false;
    }
    return true;
}

bool Nearby::clear(bool blind, bool shorter) {
    const double rate = approach_of(blind);
    begin(blind);
    double *way = motion.anew();
    for (ptrdiff_t j = 0; j < joints; j++) way[j] = fabs(command.data[j]) / rate;
    if (!way_is_clear(positions.data)) return false;
    if (!shorter) sharpen(MOST_SHARPENED); /* the certificate lasts the longer */
    which.clear();
    put_certificate();
    approach.data[0] = blind ? set.approach : INFINITY;
    counts.data[0] += 1.0, counts.data[1] = 0.0;
    return true;
}

bool Nearby::tightened() {
    const double length = dt.data[0];
    bool any = false;
    for (size_t i = 0; i < which.size(); i++) {
        const ptrdiff_t k = which[i];
        const double clearance = clearances.data[k], least = minimum(0.0, clearance);
        const double *row = G.data + (ptrdiff_t)i * joints;
        double speed = 0.0;
        for (ptrdiff_t j = 0; j < joints; j++) speed += row[j] * command.data[j];
        if (!(clearance + length * speed < least + BEND_SAMPLE)) continue;
        for (ptrdiff_t j = 0; j < joints; j++) next[(size_t)j] = positions.data[j] + length * command.data[j];
        exact->place(next.data());
        const double missing = least - (exact->distance(k) - margins.data[k]);
        if (!(missing > 0.1 * STANDING)) continue;
        lower.data[i] = maximum(lower.data[i], speed) + missing / length;
        any = true;
    }
    return any;
}

/* -- ahead ----------------------------------------------------------------------------------------------------------- */

/* The share of the certificate in memory that is used at positions x. */
double Nearby::used_at(const double *x) {
    double *way = motion.anew();
    for (ptrdiff_t j = 0; j < joints; j++) way[j] = fabs(x[j] - centre.data[j]);
    return most_of_two(&survey, weights.data, way);
}

/* Look at some pairs for the next certificate; whether there are more. */
bool Nearby::look_for_certificate(int some) {
    const ptrdiff_t before = soonest_close();
    sharpen(some);
    looked += some;
    return before >= 0 && !is_sharp(soonest_close()) && looked < 4 * SHARPENED_EARLY;
}

/* Look at some pairs that the motion to the next grid point may lead inside their margin, likewise. */
bool Nearby::look_for_node() {
    int count = 0;
    double *way = motion.anew();
    for (size_t j = 0; j < coming.size(); j++) way[j] = WIDER * fabs(coming[j]);
    for (const ptrdiff_t k : survey.close) {
        const double enough = maximum(set.evades, taken(&survey, k, &motion));
        if (is_sharp(k) || !(clearances.data[k] < enough)) continue;
        if (count++ == 2 * SHARPENED_EARLY) return true;
        bounded(k, at.data, enough, SHARP);
    }
    return false;
}

/* Find some gaps of pairs that may change the slope of the next grid point, likewise. */
bool Nearby::look_for_gaps() {
    int count = 0;
    if (!(set.evades > 0.0) || !lacks_speed(evading_slope.data, WIDER)) return false;
    for (const ptrdiff_t k : near) {
        const size_t known = gaps_stamp == sharp_stamp ? gaps.size() : 0;
        gap_of(k);
        if (gaps.size() > known && ++count == GAPS_EARLY) return true;
    }
    return false;
}

void Nearby::prepare() {
    start_survey(&survey);
    sharp_stamp++;
    job = set.evades >= 0.0 ? DONE : IDLE; /* ahead there is something to do after the next grid point */
    exact->lose();
    if (dt.data[0] > 0.0) set_watches(1.0 / dt.data[0], WATCHED);
    survey_anew(&survey, at.data, measured);
    sharpen(SHARPENED_AT_START);
}

/* First what is far; then pairs, where a step's certificate is used up soon, or where the next grid point will be. */
bool Nearby::surveys(bool shorter) {
    const bool ahead = set.evades >= 0.0;
    const double *x = ahead ? evading_positions.data : positions.data;
    double share = SURVEYS_AGAIN;
    if (ahead) { /* the grid point after it needs what the motion to it takes */
        double *way = motion.anew();
        for (size_t j = 0; j < coming.size(); j++) way[j] = WIDER * fabs(coming[j]);
        share = maximum(share, most_of_two(&survey, survey.weights.data(), way));
        share = minimum(share, MOST_NEEDED);
        if (memcmp(x, at.data, sizeof(double) * (size_t)joints) != 0) job = IDLE;
    }
    const bool soon = !ahead && slack.data[0] > 0.0 && (job == ASKING || used_at(x) > USED);
    const bool surveyed = !(soon && left_at(&survey, x) > NEEDED) && survey_piece(&survey, x, share, shorter, measured);
    const bool large = pairs > MANY_PAIRS; /* a grid point does not wait for one after the other */
    if (surveyed && (!ahead || job == DONE || !large)) return true;
    if (job == IDLE) {
        if (!ahead && (slack.data[0] <= 0.0 || used_at(x) < USED)) return false;
        follow(x);
        job = ASKING, looked = 0;
        return true;
    }
    if (job == DONE) return false;
    if (ahead) {
        const bool more = job == GAPS ? look_for_gaps() : look_for_node();
        if (!more) job = job == GAPS ? DONE : GAPS;
    } else if (!look_for_certificate(SHARPENED_EARLY / (shorter ? 2 : 1))) {
        job = IDLE;
        put_certificate();
    }
    return true;
}

/* Clearance of a pair at x: a lower bound that is at least `enough`, else as coal says. */
double Nearby::clearance_at(ptrdiff_t k, const double *x, double enough) {
    shapes.place(x);
    const double least = shapes.bound(k, INFINITY, GJK_SHARE) - margins.data[k];
    if (least >= enough) return least;
    exact->place(x);
    return exact->distance(k) - margins.data[k];
}

/* The same on the way back from a grid point, a time before it: q'' is constant there. */
double Nearby::clearance_before(ptrdiff_t k, const Arrival &to, double back, double enough) {
    for (size_t j = 0; j < coming.size(); j++) coming[j] = to.x[j] + (0.5 * back * to.curvature[j] - to.slope[j]) * back;
    return clearance_at(k, coming.data(), enough);
}

/* Whether a pair falls below `least` between two times before a grid point, with clearances there, on a way that takes no more
 * than `way`. */
bool Nearby::falls_below(ptrdiff_t k, const Arrival &to, double least, Sample late, Sample early, double way) {
    if (0.5 * (late.clearance + early.clearance - way) >= least || way < BEND_SAMPLE) return false;
    const double middle = 0.5 * (late.back + early.back);
    const Sample there = {middle, clearance_before(k, to, middle, least)};
    return there.clearance < least || falls_below(k, to, least, late, there, 0.5 * way) ||
           falls_below(k, to, least, there, early, 0.5 * way);
}

/* Whether a pair comes inside its margin, or closer inside it, on the way to a grid point: Clearance._crosses. */
bool Nearby::crosses(ptrdiff_t k, const Arrival &to, double way) {
    const double before = clearance_before(k, to, to.span, 0.0), least = minimum(before, 0.0) - STANDING;
    const double after = clearance_at(k, to.x, least);
    return after < least || falls_below(k, to, least, {0.0, after}, {to.span, before}, way);
}

ptrdiff_t Nearby::stopping(ptrdiff_t place, double span) {
    const ptrdiff_t nv = joints;
    if (place < 0 || place >= node_positions.size / nv) throw std::out_of_range("there is no such grid point");
    const Arrival to = {node_positions.data + place * nv, node_slope.data + place * nv, node_curvature.data + place * nv, span};
    double *way = motion.anew();
    for (ptrdiff_t j = 0; j < nv; j++) way[j] = BENT_WAY * fabs((0.5 * span * to.curvature[j] - to.slope[j]) * span);
    survey_now(&survey, to.x, measured);
    follow(to.x);
    const auto used = [&] { return most_of_two(&survey, survey.weights.data(), way); };
    if (left_at(&survey, to.x) < used()) survey_anew(&survey, to.x, measured);
    ptrdiff_t found = -1;
    if (used() <= left_at(&survey, to.x)) {
        found = -2;
        for (const ptrdiff_t k : survey.close) {
            const double least = taken(&survey, k, &motion);
            if (bounded(k, to.x, least, SHARP) < least && crosses(k, to, least)) {
                found = k;
                break;
            }
        }
    }
    slack.data[0] = -1.0; /* every grid point is looked at: from it the next one is prepared */
    for (ptrdiff_t j = 0; j < nv; j++) coming[(size_t)j] = to.slope[j] * span;
    job = IDLE;
    return found;
}

/* The least speed of a distance that is so far beyond the comfort. */
double Nearby::least_speed_of(double spare) const {
    return -set.approach * spare / maximum(SMALL_CLEARANCE, 1.0 - maximum(0.0, spare) / EVADES_EARLY);
}

/* Whether a pair may lack speed with a share of a slope where the joints are `at`, whatever its gradient is; those in view
 * become the near ones. */
bool Nearby::lacks_speed(const double *slope, double share) {
    double *speed = motion.anew();
    bool any = false;
    near.clear();
    for (ptrdiff_t j = 0; j < joints; j++) speed[j] = share * fabs(slope[j]);
    for (const ptrdiff_t k : survey.close) {
        if (!(bounded(k, at.data, set.evades, ROUGH) < set.evades)) continue;
        near.push_back(k);
        any = any || least_speed_of(clearances.data[k] - (set.evades - EVADES_EARLY)) > -taken(&survey, k, &motion);
    }
    return any;
}

/* The gap of a pair where the joints are `at`, found once. */
const Nearby::Gap &Nearby::gap_of(ptrdiff_t k) {
    const double *x = at.data;
    if (gaps_stamp != sharp_stamp) gaps.clear(), gaps_stamp = sharp_stamp;
    for (const Gap &gap : gaps)
        if (gap.pair == k) return gap;
    Gap found = {k, 0.0, {}};
    shapes.place(x);
    found.clearance = shapes.gap(k, found.ends) - margins.data[k];
    if (isnan(found.ends[3])) found.clearance = asked(k, x), exact->ends(k, found.ends);
    gaps.push_back(found);
    return gaps.back();
}

bool Nearby::evade() {
    const double *x = evading_positions.data, comfort = set.evades - EVADES_EARLY;
    survey_now(&survey, x, measured);
    follow(x);
    if (!lacks_speed(evading_slope.data, 1.0)) return true;
    std::vector<double> row((size_t)joints);
    bool any = false;
    evasion.begin();
    for (const ptrdiff_t k : near) {
        const Gap &gap = gap_of(k);
        if (!(gap.clearance < set.evades)) continue;
        const Eigen::Map<const Vector3> normal(gap.ends), point(gap.ends + 3);
        const Vector6 force = both(normal, point.cross(normal)); /* about the world's origin */
        double speed = 0.0;
        shapes.place(x);
        for (size_t j = 0; j < row.size(); j++) {
            const double kind = kinds.data[k * joints + (ptrdiff_t)j];
            row[j] = kind != 0.0 ? kind * force.dot(shapes.twist(j)) : 0.0;
            speed += row[j] * evading_slope.data[j];
        }
        const double lacks = least_speed_of(gap.clearance - comfort) - speed;
        const double first = clamp(lacks, 0.0, GENTLE);
        evasion.add(row, lacks - first + first * first / (2.0 * GENTLE));
        any = any || lacks > 0.0;
    }
    if (any) evasion.move(shapes, arm, carries, speeds, evading_slope.data);
    return true;
}
