/* The relaxation of forces, one step of it: the filter on wrenches, and how the grasps give way.
 * coopqp/forces/admittance.py says why. */

#include "functions.h"
#include "force_relaxation.h"

constexpr double CAREFUL_START = 0.45; /* rate at which the object begins, less by √ρ on servos ρ times other than told */
constexpr double SLOWEST_LESSON = 0.7; /* drifts are learned as fast down to this rate */
constexpr double SENSED_MOTION = 1e-4; /* joints faster than this change what a sensor reads [rad/s or m/s] */
constexpr double CONTACT_FILTER = 0.002; /* time constant of the filter on what pushes the object [s] */
constexpr double CONTACT_SETTLES = 0.1; /* and on what pushes it before it moves */
constexpr double CONTACT_LASTS = 0.5; /* the arms hold so long after the last push: the object may have bounced off [s] */
constexpr double UNTIL_TOLD = 1e-9; /* and then on, until they are told to go on: what is left of that time [s] */
constexpr double MORE_THAN_INTERNAL = 1.2; /* a contact pushes so much harder than the arms do each other, an arm that stops does not */
constexpr double MORE_THAN_STOPPED = 1.5; /* or with so many times the impulse that stops the object, as an arm that stops does, too, */
constexpr double PUSHED_FOR = 0.01; /* and the limit for this time [s]; */
constexpr double PUSHES_FADE = 0.2; /* impulses and speeds are remembered for this time [s] */
constexpr double HEAD_ON = 0.5; /* least cosine between the way that the object came and the push by what it has met */
constexpr double RETREAT_SPEED = 0.01; /* then the object goes back as fast as it came, and at least at this speed [m/s], */
constexpr double LATE_LOAD = 0.5; /* share of the inertia that may be late */
constexpr double CORRECTION_FADES = 0.5; /* time in which the path correction begins, once the arms have relaxed [s] */

/* Largest norm of the linear part of twists or wrenches, or of the angular one. */
static double largest_norm(const Twists &x, int part) {
    double most = 0.0;
    for (int k = 0; k < x.cols(); k++) most = maximum(most, x.col(k).segment<3>(3 * part).squaredNorm());
    return sqrt(most);
}

/* Largest entry, in the same way. */
static double largest_entry(const Twists &x, int part) { return x.middleRows<3>(3 * part).cwiseAbs().maxCoeff(); }

/* Take wrenches (6 N; nullptr for none) after a time. HEARD: all came; MISSED: some did not; SILENT: one has been missing
 * for too long, or has not changed by a bit for as long while the arms move. */
static Hearing feel(int arms, RelaxationArrays &f, const double *wrenches, double dt) {
    ForceRelaxation *m = f.m;
    const double share = dt / (dt + m->wrench_filter);
    const int moves = m->last_speed > SENSED_MOTION;
    Hearing heard = HEARD;
    for (int k = 0; k < arms; k++) {
        if (f.holding[k] == 0.0) { /* its sensor reads its tool alone */
            f.seen.col(k).setZero(), f.silent[k] = 0.0;
            continue;
        }
        const Vector6 wrench = wrenches ? Vector6(Eigen::Map<const Vector6>(wrenches + 6 * k)) : Vector6::Constant(NAN);
        const bool fresh = wrench.allFinite(), same = fresh && moves && !memcmp(f.seen.col(k).data(), wrench.data(), 48);
        if (fresh) f.seen.col(k) = wrench;
        else heard = heard == SILENT ? SILENT : MISSED;
        f.silent[k] = fresh && !same ? 0.0 : f.silent[k] + dt;
        if (f.silent[k] > m->wrench_silence) heard = SILENT;
    }
    double numbers[6 * (int)MOST_RELAXING];
    Twists now(numbers, 6, arms);
    now.reshaped() = f.internal_of.lazyProduct(f.seen.reshaped()) - f.target.reshaped();
    m->sharpest = largest_norm(now, 0);
    f.internal += share * (now - f.internal);
    f.felt += share * (f.seen - f.felt);
    m->largest_force = maximum(largest_norm(f.internal, 0), largest_norm(f.internal, 1) / TURN_LENGTH);
    return heard;
}

/* The share of its full rate at which the path asks the grasps to move on: a step to its end says 1 again, however slow it came. */
static double share_of_way(const ForceRelaxation *m, double rate) { return minimum(rate, m->allowed); }

/* A slow object shows little of its drift, which would be learned with the square of the rate. */
static double square_of_slow(double rate) {
    const double counts = clamp(rate, SLOWEST_LESSON, 1.0);
    return counts * counts;
}

/* Move the grasps by one step of dt, while the object moves at a rate. */
static void give_way(int arms, RelaxationArrays &f, double dt, double rate) {
    ForceRelaxation *m = f.m;
    double numbers[12 * (int)MOST_RELAXING];
    Twists way(numbers, 6, arms), moved(numbers + 6 * arms, 6, arms);
    const double size = m->largest_force, soft = clamp(m->stiffer, SOFTEST, 1.0), asks = share_of_way(m, rate);
    way.setZero();
    if (size > m->dead_band) {
        const double gain = (m->dead_band / size - 1.0) / (maximum(m->stiffer, 1.0) * m->relax_time);
        way.reshaped() = gain * f.yields.lazyProduct(f.internal.reshaped());
        /* Softer servos than given are answered more slowly, and their drift is learned more slowly in the same proportion. */
        f.drift += rate * dt * soft / (square_of_slow(rate) * m->drift_time) * way;
    }
    if (m->at_end) /* soft servos, and slow objects, would unlearn slowly what the path has asked for */
        f.drift *= 1.0 - rate * dt * (1.0 - soft * asks) / (m->drift_time + dt);
    way += asks * f.drift;
    double fastest = maximum(largest_entry(way, 0) / m->most_speed, largest_entry(way, 1) / m->most_spin);
    fastest = maximum(fastest, 1.0);
    m->relax_blend = minimum(m->relax_blend + dt / m->ramp_time, 1.0);
    moved = f.shift + dt * m->relax_blend / fastest * way;
    const double far = maximum(largest_norm(moved, 0) / m->most_reach, largest_norm(moved, 1) / m->most_turn);
    m->saturated = far >= 1.0 - 1e-9; /* also where it rests at the end of its reach, to rounding */
    f.shift = moved / maximum(far, 1.0);
}

/* The grasp of an arm that has let go comes back to its place, slowly at first, while the arm is free. Its distance from where it
 * held is forgotten as its servos spring back. */
static void return_grasps(int arms, RelaxationArrays &f, double dt) {
    const ForceRelaxation *m = f.m;
    for (int k = 0; k < arms; k++) {
        if (f.holding[k] != 0.0) continue;
        const Vector6 way = f.shift.col(k) / m->relax_time;
        const double linear = way.head<3>().cwiseAbs().maxCoeff() / m->most_speed;
        const double fastest = maximum(maximum(linear, way.tail<3>().cwiseAbs().maxCoeff() / m->most_spin), 1.0);
        f.freed[k] = minimum(f.freed[k] + dt / m->ramp_time, 1.0);
        f.shift.col(k) -= minimum(dt * f.freed[k] / fastest, m->relax_time) * way;
        f.held.col(k) += dt / (dt + m->wrench_filter) * (f.shift.col(k) - f.held.col(k));
    }
}

/* Palms press, and all forces are small, for long enough: then the object moves, slowly at first, so that forces of lags and
 * bases are felt while they are small. The pads of palms yield, and servos that do not answer make none. */
static void wait_at_rest(ForceRelaxation *m, double dt) {
    m->stage_time = m->largest_force > m->pressed_below ? 0.0 : m->stage_time + dt;
    if (!(m->stage_time > m->wait_time && m->largest_force < m->move_below)) return;
    m->stage = MOVING, m->stage_time = 0.0;
    if (!m->has_palms && m->stiffer > SOFTEST)
        m->force_cap = minimum(m->force_cap, CAREFUL_START / sqrt(maximum(m->stiffer, 1.0 / m->stiffer)));
}

/* The object is led to its path once the arms have relaxed: before, that would be a pull of its own. */
static void begin_to_correct(ForceRelaxation *m, double dt) {
    if (m->stage == MOVING) m->correction_share = minimum(m->correction_share + dt / CORRECTION_FADES, 1.0);
}

/* An object that has met something goes back the way that it came, which is free; a resting one the way it is pushed. As fast as
 * it came, at first as far as it went before that was known. */
static Vector3 begin_retreat(ForceRelaxation *m, const Vector3 &velocity, const Vector3 &off) {
    const double speed = velocity.norm(), size = off.norm();
    const bool against = -velocity.dot(off) >= HEAD_ON * speed * size && speed > 0.0;
    m->retreat_speed = maximum(speed, RETREAT_SPEED);
    m->retreat_left = speed * m->contact_late, m->retreat_from = NAN, m->goes_on = false;
    return against ? Vector3(velocity / -speed) : Vector3(off / max_of(size, 1e-12));
}

/* `retreats_at`, the speed at which the object goes back now: until nothing pushes it any more. */
static void pace_retreat(ForceRelaxation *m, const Vector3 &off, const Vector3 &back, double dt) {
    const double most = m->retreat_speed * dt;
    if (back.dot(off) >= LET_GO * m->contact_limit) m->retreat_left = maximum(m->retreat_left, most);
    const double way = minimum(m->retreat_left, most);
    m->retreat_left -= way, m->retreats_at = way / dt;
}

/* What pushes the object, beside its weight and the arms: the sum of their wrenches, less its weight and inertia. What was
 * there before it moved is no contact, nor any less of it: a payload of another mass, or a table that it is lifted from. */
static void contact(int arms, const RelaxationArrays &f, double dt) {
    ForceRelaxation *m = f.m;
    TravelOf<Vector3> &travel = *f.travel;
    PushOf<Vector3> &push = *f.push;
    const double since = max_of(m->reference_dt, 1e-6);
    if (!(m->contact_limit < INFINITY)) return;
    const Vector3 place = f.reference->p + f.reference->R * *f.centre;
    if (m->stage < MOVING) {
        travel = {place, Vector3::Zero(), Vector3::Zero()};
        m->load_acceleration = 0.0;
    } else {
        const Vector3 velocity = (place - travel.place) / since, change = (velocity - travel.velocity) / since;
        travel.place = place, travel.velocity = velocity;
        travel.acceleration += dt / (dt + m->wrench_filter) * (change - travel.acceleration);
        m->load_speed = max_of(velocity.norm(), m->load_speed * PUSHES_FADE / (PUSHES_FADE + dt));
        m->load_acceleration = max_of(change.norm(), m->load_acceleration * SERVO_PEAK / (SERVO_PEAK + dt));
    }
    Vector3 force = Vector3::Zero();
    for (int k = 0; k < arms; k++) force += f.unfed_of.block<3, 6>(6 * k, 6 * k).lazyProduct(f.seen.col(k));
    const Vector3 now = Vector3(m->weight_x, m->weight_y, m->weight_z) + m->load_mass * travel.acceleration -
                        f.reference->R * force;
    push.now += dt / (dt + CONTACT_FILTER) * (now - push.now);
    if (m->stage < MOVING) push.before += dt / (dt + CONTACT_SETTLES) * (now - push.before);
    if (m->stage < MOVING) return;
    const double share = clamp(push.now.dot(push.before) / max_of(push.before.squaredNorm(), 1e-12), 0.0, 1.0);
    const Vector3 sum = push.now - share * push.before;
    m->pushed = sum.norm();
    const double limit = (m->touches != 0.0 ? LET_GO : 1.0) * m->contact_limit;
    const int clear = m->touches != 0.0 || (!m->suspected && m->pushed > MORE_THAN_INTERNAL * m->sharpest);
    push.impulse *= PUSHES_FADE / (PUSHES_FADE + dt);
    if (m->pushed >= m->contact_limit) push.impulse += dt * sum;
    const double stops = MORE_THAN_STOPPED * m->load_mass * m->load_speed + PUSHED_FOR * m->contact_limit;
    if ((clear || push.impulse.norm() > stops) && m->pushed - LATE_LOAD * m->load_mass * m->load_acceleration >= limit) {
        if (m->touches <= UNTIL_TOLD) push.back = begin_retreat(m, travel.velocity, sum), push.last.setZero();
        if (sum.norm() > push.last.norm()) push.last = sum;
        m->touches = CONTACT_LASTS;
    } else if (m->touches != 0.0) {
        m->touches = maximum(m->touches - dt, m->goes_on ? 0.0 : UNTIL_TOLD);
    }
    m->retreats_at = 0.0;
    if (m->touches == 0.0) return;
    m->correction_share = m->force_cap = 0.0;
    pace_retreat(m, sum, push.back, dt);
}

/* Take wrenches, and move the grasps where they give way. Returns HEARD, MISSED or SILENT. */
static Hearing relax(int arms, ForceRelaxation *m, const double *wrenches, double dt) {
    RelaxationArrays f = relaxation_of(arms, m);
    const int gives = gives_way(m);
    const Hearing heard = feel(arms, f, wrenches, dt);
    m->age += dt;
    begin_to_correct(m, dt);
    if (heard == SILENT) {
        if (m->sensor_fault != SENSORS_FINE) return heard;
        int most = 0;
        for (int k = 1; k < arms; k++)
            if (f.silent[k] > f.silent[most]) most = k;
        m->sensor_fault = SENSOR_SILENT, m->sensor_arm = most, m->sensor_amount = f.silent[most];
        return heard;
    }
    contact(arms, f, dt);
    if (m->stage < RELAXING) m->start_size = maximum(m->start_size, m->largest_force);
    if (gives && m->retreats_at == 0.0) /* what pushes the object also pushes the arms against each other */
        give_way(arms, f, dt, m->stage == MOVING ? m->last_rate : 0.0);
    return_grasps(arms, f, dt);
    if (m->stage == RELAXING && m->sensor_fault == SENSORS_FINE) wait_at_rest(m, dt);
    return heard;
}
