/* A gripped arm that stops, by the measured configurations alone, where neither wrenches nor stiffness are known.
 *
 * A rigid grip drags every measured arm along: nothing parts the arms. But the object that they carry together then
 * stands elsewhere than its command, and not where it was a moment ago. Where servos lag, it does: its deviation is d =
 * −τ V with one lag τ, which does not change. So bounds of τ are kept,
 *
 *     lo, hi ← ∩ (b ∓ m) / |V|,    b the part of −d along V,    m = floor + noise + κ a,
 *
 * with the acceleration a, and a deviation that no τ within them explains is an arm that has stopped, or something that
 * the object touches. What 20 ms of lag do not explain in the first 0.2 s shows how soft the drives are, and is added to
 * m. The bounds, and what the deviation is at rest, drift by a share of the way. */

#include "functions.h"

/* Arms that are farther from where any lag would put them have an arm that has stopped [m], */
constexpr double LAG_FLOOR = 1e-3;
constexpr double LAG_HOLDS = 5e-4; /* and are held from this on beyond it [m] */
constexpr double LAG_LATE = 2e-4; /* and per acceleration of the object [s²] */
constexpr double LAG_FOLLOWS = 0.015; /* for which the lag makes itself felt this much later [s] */
constexpr double LAG_SLOWEST = 5e-3; /* slower objects show no lag [m/s] */
constexpr double LAG_LEARNS = 0.2; /* what LAG does not explain in this time at the start shows how soft drives are [s] */
constexpr double LAG_SETTLES = 0.1; /* what the deviation is at rest is averaged over this time [s] */

/* Velocity of the object as commanded, in lengths at the grasps; 0 if it is not known. */
static int told_velocity(const Core *c, Ref6 velocity) {
    Vector positions(c->scratch, c->joints, 1);
    const int arm = first_with_object(c);
    Pose before;
    positions = c->positions - c->loop->last_dt * c->velocity;
    follow_arm<false>(c, arm, positions, nullptr, &before, nullptr);
    if (!log6(between(before, c->carried[arm]), velocity)) return 0;
    velocity = c->at_grasps.transpose() * (velocity / c->loop->last_dt);
    return 1;
}

static double hasty_by_now(Core *c, const Vector6 &velocity, double dt) {
    Watch *w = c->watch;
    const Vector6 change = (velocity - c->lag_told) / (HASTE_FILTER + dt);
    c->lag_told += dt * change;
    const double hasty = w->lag_suspected ? 0.0 : change.norm();
    return w->lag_acceleration = max_of(hasty, w->lag_acceleration * SERVO_PEAK / (SERVO_PEAK + dt));
}

/* off and the part of it behind its command that a lag within the bounds explains */
static Vector6 unexplained(const Core *c, const Vector6 &off, double behind, double speed) {
    return off + min_of(max_of(behind, c->watch->lag_low * speed), c->watch->lag_high * speed) * c->lag_way;
}

/* The arm whose grasp is the farthest. */
static int farthest_grasp(const Core *c, const Vector6 &rest) {
    double most = -1.0;
    int arm = 0;
    for (int k = 0; k < c->arms; k++) {
        const double square = (rest.head<3>() + rest.tail<3>().cross(c->levers.col(k))).squaredNorm();
        if (holds(c, k) && square > most) most = square, arm = k;
    }
    return arm;
}

/* The lag lies within these bounds; they, and the deviation at rest, drift by a share of the way. */
static void learn_lag(Core *c, const Vector6 &off, double behind, double speed, double margin, double dt) {
    Watch *w = c->watch;
    w->lag_high = min_of(min_of(w->lag_high + LARGEST_SLOPE * dt, LONGEST_LAG), max_of((behind + margin) / speed, 0.0));
    w->lag_low = max_of(max_of(w->lag_low - LARGEST_SLOPE * dt, (behind - margin) / speed), 0.0);
    if (w->lag_low > w->lag_high) w->lag_low = w->lag_high = 0.5 * (w->lag_low + w->lag_high);
    const Vector6 rest = unexplained(c, off, behind, speed);
    c->lag_base += min_of(LARGEST_SLOPE * speed * dt / max_of(rest.norm(), 1e-300), 1.0) * rest;
}

static void watch_lag(Core *c, double dt, Seen *seen) {
    Watch *w = c->watch;
    Vector6 velocity;
    if (!told_velocity(c, velocity)) return;
    const Vector6 mean = mean_where(c->holding, c->deviation);
    const double hasty = hasty_by_now(c, velocity, dt), speed = velocity.norm();
    const int moves = speed > LAG_SLOWEST, rests = max_of(speed, c->lag_told.norm()) <= LAG_SLOWEST;
    if (w->lag_time == 0.0) { /* what moves shows no deviation at rest */
        if (rests) c->lag_base = mean, w->lag_time = dt, w->lag_high = LONGEST_LAG;
        return;
    }
    if (rests && mean.norm() <= LAG_FLOOR) c->lag_base = mean; /* as commanded */
    if (moves) c->lag_way = velocity / speed;
    const Vector6 off = mean - c->lag_base;
    const double behind = -off.dot(c->lag_way);
    if (w->lag_time < LAG_LEARNS) {
        w->lag_time += dt;
        w->lag_softness = max_of(w->lag_softness, (off + clamp(behind, 0.0, LAG * speed) * c->lag_way).norm());
    }
    const double lag = moves ? clamp(behind / speed, w->lag_low, w->lag_high) : w->lag_high;
    const double margin = (w->lag_suspected ? LET_GO : 1.0) * LAG_FLOOR + w->lag_noise + w->lag_softness +
                          (LAG_LATE + lag * (LAG_FOLLOWS + 0.5 * lag)) * hasty;
    const Vector6 rest = unexplained(c, off, behind, speed);
    const double excess = rest.norm() - margin;
    w->lag_suspected = excess > 0.0 && w->noise_samples >= FEW_SAMPLES;
    if (!w->lag_suspected) {
        if (moves) learn_lag(c, off, behind, speed, margin, dt);
        if (rests) c->lag_base += dt / (LAG_SETTLES + dt) * off;
        return;
    }
    const double cap = clamp(1.0 - excess / LAG_HOLDS, 0.0, 1.0);
    if (!(cap < seen->cap)) return;
    hold_for(seen, OFF_LAG, farthest_grasp(c, rest), excess, 0.0);
    seen->cap = cap, seen->hold = cap == 0.0;
}
