/* How fast the object may move for the forces: not at all before the arms have relaxed, more slowly where an internal
 * force grows or a palm's friction runs out. */

#include "functions.h"
#include "force_relaxation.h"

constexpr double RATE_FALLS = 0.6; /* the rate by forces falls with this time constant, so that braking makes none [s], */
constexpr double SLOW_RATE = 0.1; /* below this rate steadily, */
constexpr double RATE_RISES = 2.0; /* and rises in this time without forces [s], */
constexpr double LEAST_CALM = 0.1; /* or at this share of that pace where there are some */
constexpr double FRICTION_SLOWS = 0.9; /* share of a palm's friction from which on the object slows down; at 1 it rests */
constexpr double SPARE_SQUEEZE = 1.2; /* palms press with at least this multiple of the force that the felt load needs, */
constexpr double FIRMER = 100.0; /* and press harder at this speed [N/s] */

/* Share of a bound |A w| ≤ b·w of a palm that is used. */
static double share_used(const double *bound, const Vector6 &w) {
    const double asked = (Eigen::Map<const Eigen::Matrix<double, 3, 6, Eigen::RowMajor>>(bound) * w).norm();
    const double held = Eigen::Map<const Vector6>(bound + 18).dot(w);
    return held > 0.0 ? asked / held : INFINITY;
}

/* The busiest palm's use, and which it is; the normal force that all would need. */
static double palms_used(int arms, const RelaxationArrays &f, int *busiest, double *needed) {
    double most = -1.0;
    *needed = 0.0, *busiest = 0;
    for (int k = 0; k < arms; k++) {
        if (f.holding[k] == 0.0) continue;
        const double *palm = f.palms + PALM * k;
        const Vector6 w = f.seen.col(k);
        const double used = maximum(share_used(palm, w), share_used(palm + PALM_BOUND, w));
        const double pressed = Eigen::Map<const Vector6>(palm + PALM - 6).dot(w);
        *needed = maximum(*needed, pressed > 0.0 ? used * pressed : INFINITY);
        if (used > most) most = used, *busiest = k;
    }
    return most;
}

/* Raise the squeeze where the load that is felt needs more; it never falls again. */
static void press_harder(RelaxationArrays &f, double needed, double dt) {
    ForceRelaxation *m = f.m;
    m->needed += dt / (dt + m->wrench_filter) * (minimum(needed, m->most_squeeze) - m->needed);
    const double wanted = minimum(SPARE_SQUEEZE * m->needed, m->most_squeeze);
    if (!(wanted > m->pressed_with)) return;
    m->pressed_with = minimum(wanted, m->pressed_with + FIRMER * dt);
    f.target = m->pressed_with / m->squeeze * f.squeezed;
}

/* Let the rate that forces allow come closer to `cap`: it falls in proportion to itself, as braking makes forces of its own, and
 * rises the less, the more is felt, and the stiffer the servos are: there a force that is felt soon is a large one. */
static void approach_cap(ForceRelaxation *m, double cap, double dt) {
    const double falls = maximum(m->force_cap, SLOW_RATE) / RATE_FALLS;
    const double root = sqrt(maximum(m->stiffer, 1.0));
    const double calm = maximum(1.0 - root * m->largest_force / m->force_slows, LEAST_CALM) / root;
    m->force_cap = minimum(maximum(cap, m->force_cap - falls * dt), m->force_cap + calm * dt / RATE_RISES);
}

/* Whether friction is what slows the object. */
static int friction_slows(int arms, RelaxationArrays &f, double dt) {
    ForceRelaxation *m = f.m;
    double needed;
    int busiest;
    const double used = palms_used(arms, f, &busiest, &needed);
    press_harder(f, needed, dt);
    m->friction_used += dt / (dt + m->wrench_filter) * (minimum(used, 2.0) - m->friction_used);
    if (!(m->friction_used > FRICTION_SLOWS)) return 0;
    approach_cap(m, maximum((1.0 - m->friction_used) / (1.0 - FRICTION_SLOWS), 0.0), dt);
    m->why_arm = busiest;
    return 1;
}

/* Find the largest rate of the object now, `allowed`, and `why` it is less than the wanted rate. */
static void allow(int arms, ForceRelaxation *m, double dt) {
    RelaxationArrays f = relaxation_of(arms, m);
    Why why = NOTHING_MORE;
    if (m->sensor_fault != SENSORS_FINE) why = BY_SENSOR;
    else if (m->touches != 0.0) why = BY_CONTACT;
    else if (m->saturated && m->largest_force > m->force_slows) why = BY_REACH;
    else if (m->stage != MOVING) why = BY_STAGE;
    m->why = why, m->allowed = 0.0;
    if (why != NOTHING_MORE) return;
    if (m->has_palms && friction_slows(arms, f, dt)) {
        m->why = BY_FRICTION, m->allowed = minimum(m->force_cap, m->asked);
        return;
    }
    approach_cap(m, clamp((m->force_holds - m->largest_force) / (m->force_holds - m->force_slows), 0.0, 1.0), dt);
    m->why = m->force_cap >= m->asked ? NOTHING_MORE : BY_FORCE;
    m->allowed = minimum(m->force_cap, m->asked);
}

/* -- around a step --------------------------------------------------------------------------------------------------- */

/* Before a step of dt (one that observe() refuses counts as the nominal one): the grasps give way to wrenches, and the object
 * is as fast as forces let it be. */
static void relax_before_step(Core *c, const double *wrenches, double dt) {
    const double nominal = c->options->nominal_dt;
    const double length = dt >= c->options->dt_low * nominal && dt <= c->options->dt_high * nominal ? dt : nominal;
    relax(c->arms, c->relaxation, wrenches, length);
    allow(c->arms, c->relaxation, length);
    move_grasp(c, relaxation_of(c->arms, c->relaxation).shift);
    c->loop->override_rate = c->relaxation->allowed;
}

/* After it: what it asked the object and the arms for. */
static void relax_after_step(Core *c) {
    ForceRelaxation *m = c->relaxation;
    m->reference_dt = m->asked_dt, m->asked_dt = c->record->dt;
    *relaxation_of(c->arms, m).reference = *c->pose;
    m->at_end = !(c->record->clock_next > c->record->clock);
    m->last_rate = c->record->rate, m->last_speed = largest_size(vectors_of(c->record) + c->nq, c->joints);
}
