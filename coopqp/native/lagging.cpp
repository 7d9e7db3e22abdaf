/* A gripped arm that stops, by measurements alone: no lag explains where all arms are. coopqp/control/monitoring/lag.py is the
 * definition, and says why. */

#include "functions.h"

/* Velocity of the object as commanded, in lengths at the grasps; 0 if it is not known. */
static int told_velocity(const Core *c, double *velocity) {
    double *positions = c->scratch, *before = positions + c->joints, E[9], way[3], e[3], twist[6];
    const double h = c->loop->last_dt, *now = c->carried;
    for (int j = 0; j < c->joints; j++) positions[j] = c->positions[j] - h * c->velocity[j];
    carry(c, positions, before);
    multiply3_back(before, now, E);
    for (int i = 0; i < 3; i++) way[i] = now[9 + i] - before[9 + i];
    rotate_back(before, way, e);
    if (!log6(E, e, twist)) return 0;
    memset(velocity, 0, 6 * sizeof(double));
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) velocity[j] += twist[i] / h * c->at_grasps[6 * i + j];
    return 1;
}

static double hasty_by_now(Core *c, const double *velocity, double dt) {
    Watch *w = c->watch;
    double square = 0.0;
    for (int i = 0; i < 6; i++) {
        const double change = (velocity[i] - c->lag_told[i]) / (HASTE_FILTER + dt);
        c->lag_told[i] += dt * change, square += change * change;
    }
    return w->lag_haste = fmax(w->lag_suspects != 0.0 ? 0.0 : sqrt(square), w->lag_haste * SERVO_PEAK / (SERVO_PEAK + dt));
}

/* rest = off + the part of it behind its command that a lag within the bounds explains */
static void unexplained(const Core *c, const double *off, double behind, double speed, double *rest) {
    const double lag = fmin(fmax(behind, c->watch->lag_low * speed), c->watch->lag_high * speed);
    for (int i = 0; i < 6; i++) rest[i] = off[i] + lag * c->lag_way[i];
}

/* The arm whose grasp is the farthest. */
static int farthest_grasp(const Core *c, const double *rest) {
    double most = -1.0;
    int arm = 0;
    for (int k = 0; k < c->arms; k++) {
        const double *l = c->levers + 3 * k, *turn = rest + 3;
        const double x = rest[0] + turn[1] * l[2] - turn[2] * l[1], y = rest[1] + turn[2] * l[0] - turn[0] * l[2];
        const double z = rest[2] + turn[0] * l[1] - turn[1] * l[0], square = x * x + y * y + z * z;
        if (square > most) most = square, arm = k;
    }
    return arm;
}

/* The lag lies within these bounds; they, and the deviation at rest, drift by a share of the way. */
static void learn_lag(Core *c, const double *off, double behind, double speed, double margin, double dt) {
    Watch *w = c->watch;
    double rest[6];
    w->lag_high = fmin(fmin(w->lag_high + LARGEST_SLOPE * dt, LONGEST_LAG), fmax((behind + margin) / speed, 0.0));
    w->lag_low = fmax(fmax(w->lag_low - LARGEST_SLOPE * dt, (behind - margin) / speed), 0.0);
    if (w->lag_low > w->lag_high) w->lag_low = w->lag_high = 0.5 * (w->lag_low + w->lag_high);
    unexplained(c, off, behind, speed, rest);
    const double share = fmin(LARGEST_SLOPE * speed * dt / fmax(sqrt(square6(rest)), 1e-300), 1.0);
    for (int i = 0; i < 6; i++) c->lag_base[i] += share * rest[i];
}

static void watch_lag(Core *c, double dt, Seen *seen) {
    Watch *w = c->watch;
    double velocity[6], mean[6] = {0}, off[6], rest[6], behind = 0.0;
    if (!told_velocity(c, velocity)) return;
    const double hasty = hasty_by_now(c, velocity, dt), speed = sqrt(square6(velocity));
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) mean[i] += c->deviation[6 * k + i] / c->arms;
    const int moves = speed > LAG_SLOWEST, rests = fmax(speed, sqrt(square6(c->lag_told))) <= LAG_SLOWEST;
    if (w->lag_begun == 0.0) { /* what moves shows no deviation at rest */
        if (rests) memcpy(c->lag_base, mean, sizeof mean), w->lag_begun = dt, w->lag_high = LONGEST_LAG;
        return;
    }
    if (rests && sqrt(square6(mean)) <= LAG_FLOOR) memcpy(c->lag_base, mean, sizeof mean); /* as commanded */
    for (int i = 0; i < 6; i++) {
        off[i] = mean[i] - c->lag_base[i];
        if (moves) c->lag_way[i] = velocity[i] / speed;
        behind -= off[i] * c->lag_way[i];
    }
    if (w->lag_begun < LAG_LEARNS) {
        const double late = clamp(behind, 0.0, LAG * speed);
        for (int i = 0; i < 6; i++) rest[i] = off[i] + late * c->lag_way[i];
        w->lag_begun += dt, w->lag_soft = fmax(w->lag_soft, sqrt(square6(rest)));
    }
    const double lag = moves ? clamp(behind / speed, w->lag_low, w->lag_high) : w->lag_high;
    const double margin = (w->lag_suspects != 0.0 ? LET_GO : 1.0) * LAG_FLOOR + w->lag_noise + w->lag_soft +
                          (LAG_LATE + lag * (LAG_FOLLOWS + 0.5 * lag)) * hasty;
    unexplained(c, off, behind, speed, rest);
    const double excess = sqrt(square6(rest)) - margin;
    w->lag_suspects = excess > 0.0 && w->samples >= FEW_SAMPLES;
    if (w->lag_suspects == 0.0) {
        if (moves) learn_lag(c, off, behind, speed, margin, dt);
        for (int i = 0; i < 6 && rests; i++) c->lag_base[i] += dt / (LAG_SETTLES + dt) * off[i];
        return;
    }
    const double cap = clamp(1.0 - excess / LAG_HOLDS, 0.0, 1.0);
    if (!(cap < seen->cap)) return;
    hold_for(seen, OFF_LAG, farthest_grasp(c, rest), excess, 0.0);
    seen->cap = cap, seen->hold = cap == 0.0;
}
