/* Arms whose servos do not stand where their wrenches say, and distances of arms whose grasps give way.
 *
 * An arm of compliance C that pushes the object with w beside what its drives are fed forward stands C w / ρ off its
 * command, with ρ the servos' real stiffness over the given one. Where it stands elsewhere,
 *
 *     r_k = away_k + C_k (w_k − S_k load) / ρ,
 *
 * its servos do not hold it: it has stalled, or its grip slips. A lag that all arms have is in the mean of the others.
 * Arms that share joints move each other by these: Σ_j C_kj (w_j − S_j load) is in the place of the second term.
 *
 * Where the relaxation moves the grasps by d, a rigid grip keeps the arms from following, and the distance of the arms
 * as measured from as commanded parts by −d. So the arms are out of step by a_k = away_k + (d_k − d_k(reset)) only. That
 * alone does not see a stalled arm, whose forces are relaxed; the servos do. */

#include "functions.h"
#include "force_relaxation.h"

constexpr double SERVO_SLOWS = 6e-4; /* an arm this far from where its wrench puts its servos slows the object, */
constexpr double SERVO_HOLDS = 1.2e-3; /* and holds it from this on [m] */
/* And per acceleration of the joints, for what damping and late wrenches make of it [s²] */
constexpr double SERVO_LATE = 4e-4;

/* The grasps have given way: distances of the arms are counted from where they are told to hold the object now. */
static void add_shift(const Core *c, Twists &away) {
    const RelaxationArrays f = relaxation_of(c->arms, c->relaxation);
    away += f.shift - f.held;
}

static void carry_servos(Core *c, Twists &base) {
    RelaxationArrays f = relaxation_of(c->arms, c->relaxation);
    carry_drift(c, f.off_servos, f.off_drift, base);
}

/* By how much arm k gives way to a wrench on another one: both are the same but for arms that share joints. */
using ComplianceOf = Eigen::Map<const Matrix6, 0, Eigen::OuterStride<>>;
static ComplianceOf compliance_of(const Core *c, const RelaxationArrays &f, int k, int other) {
    const int n = 6 * c->arms;
    return ComplianceOf(f.compliances + 6 * k * n + 6 * other, Eigen::OuterStride<>(n));
}

/* How far each arm is from where its servos should hold it by its wrench: away + C (w − share of the load) / ρ. */
static void compare_with_servos(const Core *c, const RelaxationArrays &f, const Twists &away, Twists &off) {
    const Vector3 load = c->pose->R.transpose() * Vector3(f.m->weight_x, f.m->weight_y, f.m->weight_z);
    Twists pushed(c->scratch + 36 * c->arms, 6, c->arms);
    pushed.reshaped() = f.unfed_of.lazyProduct(f.felt.reshaped()) - f.carries.lazyProduct(load);
    const double stiffer = maximum(f.m->stiffer, SOFTEST);
    for (int k = 0; k < c->arms; k++) off.col(k) = away.col(k) + compliance_of(c, f, k, k) * pushed.col(k) / stiffer;
    for (int g = 0; g < c->groups; g++)
        for (int i = 0; i < c->group[g].arms; i++)
            for (int j = 0; j < c->group[g].arms; j++) {
                const int k = c->group[g].arm[i], other = c->group[g].arm[j];
                if (other != k) off.col(k) += compliance_of(c, f, k, other) * pushed.col(other) / stiffer;
            }
}

/* The largest acceleration of a joint as commanded, filtered and remembered for a while; while an arm is suspected, the object slows
 * down for that very reason, which must not excuse the arm. */
static double haste(Core *c, ForceRelaxation *m, double dt) {
    double most = 0.0;
    for (int j = 0; j < c->joints; j++) {
        const double change = (c->velocity[j] - c->told_velocity[j]) / (HASTE_FILTER + dt);
        most = max_of(most, fabs(change));
        c->told_velocity[j] += dt * change;
    }
    m->joint_acceleration = max_of(m->suspected ? 0.0 : most, m->joint_acceleration * SERVO_PEAK / (SERVO_PEAK + dt));
    return m->joint_acceleration;
}

static void watch_servos(Core *c, const Twists &away, double dt, Seen *seen) {
    RelaxationArrays f = relaxation_of(c->arms, c->relaxation);
    ForceRelaxation *m = f.m;
    const auto scratch = [&](int i) { return Twists(c->scratch + 6 * i * c->arms, 6, c->arms); };
    Twists off = scratch(0), at_grasps = scratch(1), apart = scratch(2);
    const double hasty = haste(c, m, dt);
    if (m->stage < RELAXING || m->sensor_fault != SENSORS_FINE) return;
    compare_with_servos(c, f, away, off);
    to_grasps(c, off, at_grasps);
    const double time = c->options->filter_time, share = sqrt(dt / (2.0 * time + dt)); /* of the noise that passes */
    const double noise = share * m->servo_noise; /* before this sample, which may be the first of a stall */
    m->servo_noise = noise_seen(c, &m->servo_samples, f.off_last, f.off_step, f.off_noise, at_grasps, dt);
    f.off_servos += dt / (time + dt) * (at_grasps - f.off_servos);
    if (m->servo_samples < FEW_SAMPLES) return;
    from_others(c->holding, f.off_servos, apart);
    const double most = max_of((apart - f.off_drift).cwiseAbs().maxCoeff(), 1e-300);
    f.off_drift += min_of(LARGEST_SLOPE * m->joint_way / most, 1.0) * (apart - f.off_drift); /* the load is shared otherwise */
    apart -= f.off_drift;
    int arm = 0;
    for (int k = 1; k < c->arms; k++)
        if (apart.col(k).squaredNorm() > apart.col(arm).squaredNorm()) arm = k;
    const double far = apart.col(arm).norm();
    /* Softer servos than given deflect more for the same force, and what their damping makes of it is as much larger. */
    const double soft = clamp(m->stiffer, SOFTEST, 1.0);
    const double worst = soft * (far - c->options->noise_margin * noise) - SERVO_LATE * hasty;
    m->suspected = worst > SERVO_SLOWS;
    if (!m->suspected) return;
    Seen found;
    hold_for(&found, OFF_SERVOS, arm, far, 0.0);
    if (worst < SERVO_HOLDS) {
        found.cap = (SERVO_HOLDS - worst) / (SERVO_HOLDS - SERVO_SLOWS), found.hold = 0;
        fall_gently(c, dt, &found);
    }
    if (found.cap < seen->cap) *seen = found;
}
