/* Pose and twist of the object's path: straight segments of 21 numbers
 *   R(0) 0–8, p(0) 9–11, rotation vector 12–14, displacement 15–17, start 18, duration 19, time law 20 (1: quintic)
 * as LinePath, WaypointPath, HoldPath and ServoPath pack them, or a path that only its owner knows. */

#include "functions.h"

/* u(x): TimeLaw.value_at */
static double time_law(double x, double quintic) {
    if (x <= 0.0) return 0.0;
    if (x >= 1.0) return 1.0;
    double u = quintic != 0.0 ? x * x * x * (10.0 + x * (6.0 * x - 15.0)) : x;
    return u > 1.0 ? 1.0 : u; /* by rounding; a NaN stays one */
}

/* u′(x): TimeLaw.slope_at */
static double time_law_slope(double x, double quintic) {
    if (x < 0.0 || x >= 1.0) return 0.0;
    return quintic != 0.0 ? 30.0 * x * x * (1.0 - x) * (1.0 - x) : 1.0;
}

static int count_of(const Core *c, int what) { return (int)c->path_numbers[what]; }

/* The segment at a clock; `end` is where the next one begins. */
static const double *segment_at(const Core *c, double clock, double *end) {
    const int count = count_of(c, 2);
    const double *segment = c->path_numbers + 3 + count_of(c, 1);
    int i = 0;
    while (i + 1 < count && segment[SEGMENT * (i + 1) + 18] <= clock) i++;
    *end = i + 1 < count ? segment[SEGMENT * (i + 1) + 18] : INFINITY;
    return segment + SEGMENT * i;
}

static double next_breakpoint(const Core *c, double clock) {
    for (int i = 0; i < count_of(c, 1); i++)
        if (c->path_numbers[3 + i] > clock + 1e-9) return c->path_numbers[3 + i];
    return c->duration;
}

static void pose_on(const double *segment, double u, double *R, double *p) {
    double w[3], E[9];
    for (int i = 0; i < 3; i++) {
        w[i] = u * segment[12 + i];
        p[i] = segment[9 + i] + u * segment[15 + i];
    }
    exp3(w, E);
    multiply3(segment, E, R);
}

static int path_pose(Core *c, double clock, double *R, double *p) {
    if (count_of(c, 2)) {
        double end;
        const double *segment = segment_at(c, clock, &end);
        pose_on(segment, time_law((clock - segment[18]) / segment[19], segment[20]), R, p);
        return 1;
    }
    double pose[12];
    if (!c->own_path || !c->own_path(c, clock, 0, pose)) return 0;
    memcpy(R, pose, 9 * sizeof(double));
    memcpy(p, pose + 9, 3 * sizeof(double));
    return 1;
}

static int path_twist(Core *c, double clock, double *twist) {
    if (!count_of(c, 2)) return c->own_path && c->own_path(c, clock, 1, twist);
    double end, R[9], p[3];
    const double *segment = segment_at(c, clock, &end);
    const double x = (clock - segment[18]) / segment[19], rate = time_law_slope(x, segment[20]) / segment[19];
    pose_on(segment, time_law(x, segment[20]), R, p);
    rotate_back(R, segment + 15, twist);
    for (int i = 0; i < 3; i++) {
        twist[i] *= rate;
        twist[3 + i] = rate * segment[12 + i];
    }
    return 1;
}

static int path_increment(Core *c, double clock, double span, const double *R, const double *p, double *twist) {
    memset(twist, 0, 6 * sizeof(double));
    if (!(span > 1e-12)) return 1;
    double end;
    const double *segment = count_of(c, 2) ? segment_at(c, clock, &end) : NULL;
    if (segment && clock + span <= end) { /* log of one screw is known */
        const double x = (clock - segment[18]) / segment[19];
        const double gain = time_law(x + span / segment[19], segment[20]) - time_law(x, segment[20]);
        double step[3], omega[3];
        rotate_back(R, segment + 15, step);
        for (int i = 0; i < 3; i++) {
            step[i] *= gain;
            omega[i] = gain * segment[12 + i];
        }
        double t2 = dot3(omega, omega), t = sqrt(t2);
        double third = t2 < 1e-4 ? 1.0 / 12 + t2 * (1.0 / 720 + t2 / 30240) : (1.0 - 0.5 * t / tan(0.5 * t)) / t2;
        unroll(omega, third, step, twist);
        memcpy(twist + 3, omega, sizeof omega);
    } else {
        double R1[9], p1[3], E[9], e[3];
        if (!path_pose(c, clock + span, R1, p1)) return 0;
        multiply3_back(R, R1, E);
        for (int i = 0; i < 3; i++) p1[i] -= p[i];
        rotate_back(R, p1, e);
        if (!log6(E, e, twist)) return 0;
    }
    for (int i = 0; i < 6; i++) twist[i] /= span;
    return 1;
}
