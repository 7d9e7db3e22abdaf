/* Arms whose servos do not stand where their wrenches say. coopqp/control/monitoring/servos.py is the definition, and says why. */

#include "functions.h"
#include "minding.h"

/* The grasps have given way: distances of the arms are counted from where they are told to hold the object now. */
static void add_shift(const Core *c, double *away) {
    const MindingArrays f = minding_of(c->arms, c->minding);
    for (int i = 0; i < 6 * c->arms; i++) away[i] += f.shift[i] - f.held[i];
}

/* How far each arm is from where its servos should hold it by its wrench: away + C (w − share of the load) / ρ. */
static void compare_with_servos(const Core *c, const MindingArrays *f, const double *away, double *off) {
    const int n = 6 * c->arms;
    const Minding *m = f->m;
    const double stiffer = maximum(m->stiffer, SOFTEST), weight[3] = {m->weight_x, m->weight_y, m->weight_z};
    double load[3], *pushed = c->scratch + 6 * n;
    rotate_back(c->R, weight, load);
    for (int i = 0; i < n; i++) {
        pushed[i] = -dot3(f->carries + 3 * i, load);
        for (int j = 0; j < n; j++) pushed[i] += f->unfed_of[n * i + j] * f->felt[j];
    }
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) {
            double bent = 0.0;
            for (int j = 0; j < 6; j++) bent += f->compliances[36 * k + 6 * i + j] * pushed[6 * k + j];
            off[6 * k + i] = away[6 * k + i] + bent / stiffer;
        }
}

/* The largest acceleration of a joint as commanded, filtered and remembered for a while; while an arm is suspected, the object slows
 * down for that very reason, which must not excuse the arm. */
static double haste(Core *c, Minding *m, double dt) {
    double most = 0.0;
    for (int j = 0; j < c->joints; j++) {
        const double change = (c->velocity[j] - c->told_velocity[j]) / (HASTE_FILTER + dt);
        most = fmax(most, fabs(change));
        c->told_velocity[j] += dt * change;
    }
    m->haste = fmax(m->suspected != 0.0 ? 0.0 : most, m->haste * SERVO_PEAK / (SERVO_PEAK + dt));
    return m->haste;
}

static void watch_servos(Core *c, const double *away, double dt, Seen *seen) {
    const MindingArrays f = minding_of(c->arms, c->minding);
    Minding *m = f.m;
    double *off = c->scratch, *at_grasps = off + 6 * c->arms, *apart = at_grasps + 6 * c->arms;
    const double hasty = haste(c, m, dt);
    if (m->stage < RELAXING || m->sensor_fault != SENSORS_FINE) return;
    compare_with_servos(c, &f, away, off);
    to_grasps(c, off, at_grasps);
    const double time = c->options->filter_time, share = sqrt(dt / (2.0 * time + dt)); /* of the noise that passes */
    const double noise = share * m->servo_noise; /* before this sample, which may be the first of a stall */
    m->servo_noise = noise_seen(c->arms, &m->servo_samples, f.off_last, f.off_step, f.off_noise, at_grasps, dt);
    for (int i = 0; i < 6 * c->arms; i++) f.off_servos[i] += dt / (time + dt) * (at_grasps[i] - f.off_servos[i]);
    if (m->servo_samples < FEW_SAMPLES) return;
    from_others(c, f.off_servos, apart);
    double most = 1e-300;
    for (int i = 0; i < 6 * c->arms; i++) most = fmax(most, fabs(apart[i] - f.off_drift[i]));
    const double drifts = fmin(LARGEST_SLOPE * m->way_done / most, 1.0); /* where the load is shared otherwise */
    for (int i = 0; i < 6 * c->arms; i++) {
        f.off_drift[i] += drifts * (apart[i] - f.off_drift[i]);
        apart[i] -= f.off_drift[i];
    }
    int arm = 0;
    for (int k = 1; k < c->arms; k++)
        if (square6(apart + 6 * k) > square6(apart + 6 * arm)) arm = k;
    const double far = sqrt(square6(apart + 6 * arm));
    /* Softer servos than given deflect more for the same force, and what their damping makes of it is as much larger. */
    const double soft = clamp(m->stiffer, SOFTEST, 1.0);
    const double worst = soft * (far - c->options->noise_margin * noise) - SERVO_LATE * hasty;
    m->suspected = worst > SERVO_SLOWS;
    if (m->suspected == 0.0) return;
    Seen found;
    hold_for(&found, OFF_SERVOS, arm, far, 0.0);
    if (worst < SERVO_HOLDS) {
        found.cap = (SERVO_HOLDS - worst) / (SERVO_HOLDS - SERVO_SLOWS), found.hold = 0;
        fall_gently(c, dt, &found);
    }
    if (found.cap < seen->cap) *seen = found;
}
