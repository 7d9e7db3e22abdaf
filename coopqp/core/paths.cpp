/* Pose and twist of the object's path: segments of 29 numbers
 *   R(0) 0–8, p(0) 9–11, rotation vector 12–14, displacement 15–17, start 18, duration 19, time law 20 (0 linear,
 *   1 quintic, 2 ramps, 3 even acceleration from 21, the speed at the start over the mean one), velocity 21–23 and angular velocity 24–26 that die away, times of both ramps 27–28
 * as the library's own paths pack them, or a path that only its owner knows.
 * Shifts of the path, in their order, of 8 numbers: the clocks at which it begins to come in and is in wholly, which fall
 * on the way back, and the logarithm of the shift in the world. */

#include "functions.h"

/* Turns are about one axis where the squared sine of the angle between their axes is below this */
constexpr double SAME_AXIS = 1e-24;

/* How far along a segment: u of its straight way, b of the motion that dies away, and their changes a second. */
struct Place {
    double u, rate, b, fading;
};

/* TimeLaw.value_at and slope_at */
static Place on_law(double x, double law, double first, double duration) {
    Place at = {};
    const int quintic = law == 1.0;
    const double w = law == 3.0 ? first : 1.0;
    if (x >= 0.0 && x < 1.0)
        at.rate = (quintic ? 30.0 * x * x * (1.0 - x) * (1.0 - x) : w + 2.0 * (1.0 - w) * x) / duration;
    if (x <= 0.0) return at;
    at.u = quintic ? x * x * x * (10.0 + x * (6.0 * x - 15.0)) : x * (w + (1.0 - w) * x);
    if (x >= 1.0 || at.u > 1.0) at.u = 1.0; /* by rounding; a NaN stays one */
    return at;
}

/* _Way._shares */
static Place on_ramps(double t, double T, double B, double E) {
    const double peak = 1.0 / (T - 0.5 * (B + E)), left = T - t;
    Place at = {};
    if (t >= T) {
        at.u = 1.0, at.b = 0.5 * B;
        return at;
    }
    if (t < 0.0) return at;
    at.b = t < B ? t - 0.5 * t * t / B : 0.5 * B;
    at.fading = t < B ? 1.0 - t / B : 0.0;
    if (left < E)
        at.u = 1.0 - 0.5 * peak * left * left / E, at.rate = peak * left / E;
    else if (t < B)
        at.u = 0.5 * peak * t * t / B, at.rate = peak * t / B;
    else
        at.u = peak * (t - 0.5 * B), at.rate = peak;
    return at;
}

static int has_ramps(const double *segment) { return segment[20] == 2.0; }

static Place place_on(const double *segment, double clock) {
    const double t = clock - segment[18];
    if (has_ramps(segment)) return on_ramps(t, segment[19], segment[27], segment[28]);
    return on_law(t / segment[19], segment[20], segment[21], segment[19]);
}

static int count_of(const Core *c, int what) { return (int)c->path_numbers[what]; }

/* The segment at a clock; `end` is where the next one begins. */
static const double *segment_at(const Core *c, double clock, double *end) {
    const int count = count_of(c, 2);
    const double *segment = c->path_numbers + 3 + count_of(c, 1);
    int i = 0;
    for (int n = count; n > 1;) { /* the last one that has begun; a plan has hundreds */
        const int half = n / 2;
        if (segment[SEGMENT * (i + half) + 18] <= clock) i += half, n -= half;
        else n = half;
    }
    *end = i + 1 < count ? segment[SEGMENT * (i + 1) + 18] : INFINITY;
    return segment + SEGMENT * i;
}

static double next_breakpoint(const Core *c, double clock) {
    double after = c->duration;
    for (int i = 0; i < count_of(c, 1); i++)
        if (c->path_numbers[3 + i] > clock + SAME_CLOCK) {
            after = minimum(after, c->path_numbers[3 + i]);
            break;
        }
    for (int i = 0; i < c->ahead->kink_count; i++)
        if (c->kinks[i] > clock + SAME_CLOCK) return minimum(after, c->kinks[i]);
    return after;
}

static Pose pose_on(const double *segment, Place at) {
    const Eigen::Map<const Vector3> p(segment + 9), turn(segment + 12), way(segment + 15);
    Pose T = {Eigen::Map<const Matrix3>(segment) * exp3(at.u * turn), p + at.u * way};
    if (has_ramps(segment)) {
        const Eigen::Map<const Vector3> velocity(segment + 21), spin(segment + 24);
        T = {exp3(at.b * spin) * T.R, T.p + at.b * velocity};
    }
    return T;
}

/* ShiftedPath: the pose of the unshifted path becomes the one of the shifted path; so does the twist if there is one. */
static void shift_on(const Core *c, double clock, Pose &T, Vector6 *twist) {
    const bool rests = !(clock >= 0.0 && clock < c->duration);
    const double at = clamp(clock, 0.0, c->duration);
    for (int i = 0; i < c->shift_count; i++) {
        const double *shift = c->shifts + SHIFT * i, span = shift[1] - shift[0];
        const Place share = on_law((at - shift[0]) / span, 1.0, 0.0, span);
        const Eigen::Map<const Vector6> log(shift + 2);
        if (twist && share.rate != 0.0 && !rests) { /* the motion log, seen from T */
            const Vector3 linear = log.head<3>() + log.tail<3>().cross(T.p);
            *twist += share.rate * both(T.R.transpose() * linear, T.R.transpose() * log.tail<3>());
        }
        if (share.u != 0.0) T = compose(exp6(share.u * log), T);
    }
}

static int path_pose(Core *c, double clock, Pose &T) {
    if (count_of(c, 2)) {
        double end;
        const double *segment = segment_at(c, clock, &end);
        T = pose_on(segment, place_on(segment, clock));
        shift_on(c, clock, T, nullptr);
        return 1;
    }
    c->asked++;
    if (!c->own_path || !c->own_path(c, clock, 0)) return 0;
    T = *c->own_pose;
    return 1;
}

static int path_twist(Core *c, double clock, Ref6 twist) {
    if (!count_of(c, 2)) {
        c->asked++;
        if (!c->own_path || !c->own_path(c, clock, 1)) return 0;
        twist = Eigen::Map<const Vector6>(c->own_pose->R.data());
        return 1;
    }
    double end;
    const double *segment = segment_at(c, clock, &end);
    const Place at = place_on(segment, clock);
    const Eigen::Map<const Vector3> turn(segment + 12), way(segment + 15), dying(segment + 21), spin(segment + 24);
    Pose T = pose_on(segment, at);
    const Matrix3 &R = T.R;
    Vector3 velocity = at.rate * way, angular = at.rate * turn;
    if (has_ramps(segment)) velocity += at.fading * dying, angular += at.fading * (R.transpose() * spin);
    Vector6 found = both(R.transpose() * velocity, angular);
    shift_on(c, clock, T, &found);
    twist = found;
    return 1;
}

static int own_path(const Core *c) { return c->users_path; }

/* The pose of a user's path at a clock, or in its first numbers the twist. */
static int ask_own(Core *c, int pose, double clock, Pose &out) {
    return pose ? path_pose(c, clock, out) : path_twist(c, clock, Eigen::Map<Vector6>(out.R.data()));
}

static double asked_distance(int pose, const Pose &A, const Pose &B) {
    if (pose) return pose_distance(A, B);
    const Vector6 d = Eigen::Map<const Vector6>(B.R.data()) - Eigen::Map<const Vector6>(A.R.data());
    return d.head<3>().norm() + TURN_LENGTH * d.tail<3>().norm();
}

static int begin_seeking(Core *c, int pose, double from, double to) {
    Ahead *a = c->ahead;
    if (!ask_own(c, pose, from, *c->seek_low) || !ask_own(c, pose, to, *c->seek_high)) return 0;
    a->seek_from = from, a->seek_to = to, a->seek_whole = asked_distance(pose, *c->seek_low, *c->seek_high);
    return a->seek_whole > (pose ? maximum(FASTEST_PATH * (to - from), LEAST_JUMP) : LEAST_KINK);
}

static int seeks_on(const Core *c, int pose) {
    const Ahead *a = c->ahead;
    const double narrow = maximum(STEEP_WIDTH, STEEP_SHARE * a->steep_at);
    return a->seek_to - a->seek_from > (!pose ? KINK_WIDTH : a->steep_by > 0.0 ? narrow : JUMP_WIDTH);
}

static int go_on_seeking(Core *c, int pose) {
    Ahead *a = c->ahead;
    Pose middle = *c->seek_low;
    const double clock = 0.5 * (a->seek_from + a->seek_to);
    if (!ask_own(c, pose, clock, middle) || !(a->seek_from < clock && clock < a->seek_to)) return 0;
    if (asked_distance(pose, *c->seek_low, middle) >= asked_distance(pose, middle, *c->seek_high))
        a->seek_to = clock, *c->seek_high = middle;
    else
        a->seek_from = clock, *c->seek_low = middle;
    return 1;
}

static double found_by_seeking(const Core *c, int pose) {
    const double there = asked_distance(pose, *c->seek_low, *c->seek_high), share = KINK_SHARE * c->ahead->seek_whole;
    return there > (pose ? share : maximum(share, LEAST_KINK)) ? there : 0.0;
}

/* Turn and displacement between two clocks where the axis of the turn stays: on a segment, or on it and the next one, as
 * the many pieces of a plan along a line follow each other. */
static int along_one_axis(const Core *c, double from, double to, Vector3 &omega, Vector3 &moved) {
    double end;
    if (!count_of(c, 2) || c->shift_count) return 0;
    const double *segment = segment_at(c, from, &end);
    if (has_ramps(segment)) return 0;
    const Eigen::Map<const Vector3> turn(segment + 12), way(segment + 15);
    const double gain = (to <= end ? place_on(segment, to).u : 1.0) - place_on(segment, from).u;
    omega = gain * turn, moved = gain * way;
    if (!(to > end)) return 1; /* a NaN is beyond no segment */
    const double *next = segment + SEGMENT, *after = next + SEGMENT;
    const double *last = c->path_numbers + 3 + count_of(c, 1) + SEGMENT * (count_of(c, 2) - 1);
    if (has_ramps(next) || (next < last && to > after[18])) return 0;
    const Eigen::Map<const Vector3> turn_on(next + 12), way_on(next + 15);
    if (turn.cross(turn_on).squaredNorm() > SAME_AXIS * turn.squaredNorm() * turn_on.squaredNorm()) return 0;
    const double more = place_on(next, to).u;
    omega += more * turn_on, moved += more * way_on;
    return 1;
}

static int path_increment(Core *c, double clock, double span, const Pose &T, Ref6 twist) {
    twist.setZero();
    if (!(span > 1e-12)) return 1;
    Vector3 omega, moved;
    if (along_one_axis(c, clock, clock + span, omega, moved)) { /* log of one screw is known */
        const double t2 = omega.squaredNorm(), t = sqrt(t2);
        const double third = t2 < 1e-4 ? 1.0 / 12 + t2 * (1.0 / 720 + t2 / 30240) : (1.0 - 0.5 * t / tan(0.5 * t)) / t2;
        twist = both(unroll(omega, third, T.R.transpose() * moved), omega);
    } else {
        Pose later;
        if (!path_pose(c, clock + span, later) || !log6(between(T, later), twist)) return 0;
    }
    twist /= span;
    return 1;
}
