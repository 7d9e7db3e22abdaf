/* Retargeting to a new target in motion: the way there (coopqp/paths/servo.py defines it), and whether it is taken: if the first
 * step along it keeps to its rate and no joint jumps.
 *
 * The way begins at a rate: at the full one, or at the present one, then its twist is as much larger. If the object rests the
 * way begins at rest, and so do the joints: self-motion that goes on there has to come to rest before. */

#include "functions.h"

constexpr double SURELY_LESS = 1e-6; /* a rate that falls by more does not only fall by rounding */
constexpr double CHANGE_SHARE = 0.7; /* share of the accelerations that a change of the motion is planned with */
constexpr double LARGEST_JUMP = 2.0 / STEPS_TO_FULL_SPEED; /* share of its speed by which a joint jumps */

/* Start of a way, and its unknowns. */
struct Way {
    Pose T;              /* in motion */
    Vector6 twist;       /* its velocity, in world axes */
    Pose goal;
    double speed, spin;  /* of the straight way */
    double begin;        /* time in which the present motion dies away [s] */
    Vector3 line, turn;  /* the straight way */
    Vector6 full;        /* its twist at full speed, in world axes */
};

/* Set the straight way from where the present motion ends; its time at full speed [s]. */
static double straight(Way *w) {
    const Vector6 gone = 0.5 * w->begin * w->twist;
    const Matrix3 R = exp3(gone.tail<3>()) * w->T.R;
    w->turn = rotation_vector(R.transpose() * w->goal.R);
    w->line = w->goal.p - w->T.p - gone.head<3>();
    const double nominal = max_of(w->line.norm() / w->speed, w->turn.norm() / w->spin);
    w->full.setZero();
    if (nominal < NOWHERE) return 0.0;
    w->full = both(w->line, R * w->turn) / nominal;
    return nominal;
}

/* Seconds that each joint takes for the present motion, and for the straight way at full speed. */
static void ramp_times(Core *c, const Way *w, const double *jacobian, Vector &before, Vector &after) {
    Twists twists = sketch_of(c).w;
    twists.colwise() = w->twist;
    before.setZero(), after.setZero();
    if (!two_velocities(c, jacobian, twists, w->full, nullptr, nullptr, before, after)) { /* an arm is singular */
        floored_velocities(c, jacobian, twists, before);
        twists.colwise() = w->full;
        floored_velocities(c, jacobian, twists, after);
    }
    for (int j = 0; j < c->joints; j++) {
        const double planned = CHANGE_SHARE * c->plan_acceleration[j];
        before[j] /= planned, after[j] /= planned;
    }
}

/* The largest share of the full speed that leaves time to change the motion before and after. */
static double largest_speed(const Core *c, const double *before, const double *after, double nominal, double *change) {
    const double most = largest_size(after, c->joints);
    for (int i = SPEEDS; i > 0; i--) {
        const double share = (double)i / SPEEDS;
        *change = 0.0;
        for (int j = 0; j < c->joints; j++) *change = max_of(*change, fabs(share * after[j] - before[j]));
        if (i == 1 || 0.5 * share * (*change + share * most) <= nominal) return share;
    }
    return 0.0;
}

/* The segment of a way that begins at a clock. */
static void way_to(Core *c, Way *w, double clock, double *segment) {
    Sketch s = sketch_of(c);
    Vector &before = s.step, &after = s.after;
    double end = 0.0, duration;
    w->begin = 0.0;
    carry_and_linearise(c, c->positions, w->T.p, nullptr, s.jacobian);
    if (!(w->twist.cwiseAbs().maxCoeff() > STILL_OBJECT)) {
        w->twist.setZero();
        const double nominal = straight(w);
        ramp_times(c, w, s.jacobian, before, after);
        for (int j = 0; j < c->joints; j++)
            if (!isfinite(c->acceleration[j])) { /* no joint stops from more than its full speed */
                const double speed = isfinite(c->speed[j]) ? c->speed[j] : 1.0;
                end = max_of(end, min_of(fabs(after[j]), speed / (CHANGE_SHARE * c->plan_acceleration[j])));
            }
        duration = max_of(max_of(nominal + 0.5 * end, end), SHORTEST_CHANGE);
    } else {
        double share = 1.0, nominal = 0.0, change = 0.0;
        w->full.setZero();
        ramp_times(c, w, s.jacobian, before, after);
        w->begin = max_of(largest_size(before, c->joints), SHORTEST_CHANGE);
        for (int pass = 0; pass < 4; pass++) { /* the way begins where the present motion has died away */
            nominal = straight(w);
            ramp_times(c, w, s.jacobian, before, after);
            share = largest_speed(c, before, after, nominal, &change);
            w->begin = max_of(change, SHORTEST_CHANGE);
        }
        nominal = straight(w);
        ramp_times(c, w, s.jacobian, before, after);
        end = max_of(share * largest_size(after, c->joints), SHORTEST_CHANGE);
        duration = max_of(nominal / share + 0.5 * (w->begin + end), w->begin + end);
    }
    *reinterpret_cast<Pose *>(segment) = w->T;
    Eigen::Map<Vector6>(segment + 12) = both(w->turn, w->line);
    segment[18] = clock, segment[19] = duration, segment[20] = 2.0;
    Eigen::Map<Vector6>(segment + 21) = w->twist;
    segment[27] = w->begin, segment[28] = end;
}

/* Whether a joint without acceleration limit jumps from its last velocity to another; nullptr for rest. */
static int jumps(const Core *c, const double *velocity) {
    for (int j = 0; j < c->joints; j++) {
        const double speed = isfinite(c->speed[j]) ? c->speed[j] : 1.0;
        const double change = fabs((velocity ? velocity[j] : 0.0) - c->velocity[j]);
        if (!isfinite(c->acceleration[j]) && !(change <= LARGEST_JUMP * speed)) return 1;
    }
    return 0;
}

/* Whether joints forbid the first step a rate, however far the object may be seen to go on; with some grid points known. */
static int forbidden(Core *c, double rate) {
    const double clock = c->loop->clock;
    /* The cap says how fast corrections are, and how far the step looks along the path where its twist jumps. */
    if (c->loop->corrects || next_breakpoint(c, clock) <= clock + c->options->nominal_dt) return 0;
    observe(c, nullptr, nullptr);
    c->given_rows = 0, c->proposal->cap = rate, c->proposal->brake_keep = 1.0;
    return propose_capped(c) == RATE_SEARCH && c->proposal->new_rate < rate - SURELY_LESS;
}

/* Try a path from the present clock on at a rate: 1 if its first step keeps to it, and no joint jumps; the joints may force
 * a rate above the cap. What was known ahead stays in the ring. */
static int admits(Core *c, const double *numbers, double rate, int needed) {
    const int kept = c->ahead->count + c->ahead->passing + 2;
    const double clock = c->loop->clock, least = needed ? rate : 0.0;
    c->path_numbers = numbers;
    c->loop->rate = rate, c->loop->rate_slope = 0.0;
    if (c->looks_ahead) {
        preview_try(c, clock, kept);
        int steps = NEWTON_STEPS_AT_START, more = preview_grow(c, clock, least, &steps);
        if (more > 0 && needed && forbidden(c, rate)) return 0;
        while (more > 0) more = preview_grow(c, clock, least, &steps);
        if (more < 0) return 0;
    }
    if (!needed) return 1;
    return try_step(c) >= rate - RATE_TOLERANCE && !jumps(c, c->command);
}

static int retarget(Core *c, const double *goal, double speed, double spin, double rate, double *numbers) {
    const double clock = c->loop->clock, now = c->loop->rate, *present = c->path_numbers;
    Vector6 twist;
    Way w;
    w.goal = *reinterpret_cast<const Pose *>(goal), w.speed = speed, w.spin = spin;
    keep_sines(c, c->positions, 0.5 * CLOSE_BY);
    if (!path_pose(c, clock, w.T) || !path_twist(c, clock, twist)) return 0;
    const bool rests = !((now * twist).cwiseAbs().maxCoeff() > STILL_OBJECT);
    if (rests ? jumps(c, nullptr) : !(rate > 0.0)) return 0; /* at rest self-motion has to end before the new way begins */
    if (rests) rate = 0.0;
    const Ahead ahead = *c->ahead;
    const Loop loop = *c->loop;
    w.twist = (rests ? 0.0 : now / rate) * turned(w.T.R, twist);
    double *segment = numbers + 4;
    way_to(c, &w, clock, segment);
    numbers[0] = c->duration, numbers[1] = numbers[2] = 1.0, numbers[3] = clock + segment[19];
    const int taken = admits(c, numbers, rate, !rests);
    const Loop now_quiet = *c->loop; /* regions that are known now */
    *c->loop = loop;
    c->loop->quiet_ahead_slack = now_quiet.quiet_ahead_slack;
    c->loop->quiet_slack = now_quiet.quiet_slack, c->loop->quiet_approach = now_quiet.quiet_approach;
    if (taken > 0) {
        c->loop->rate = rate, c->loop->rate_slope = 0.0, c->ahead->kept = 0;
    } else {
        *c->ahead = ahead;
        c->path_numbers = present;
    }
    return taken;
}
