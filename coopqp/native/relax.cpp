/* The relaxation of forces, one step of it: the filter on wrenches, and how the grasps give way. relax_plain.py says the
 * same in NumPy, coopqp/forces/admittance.py says why. */

#include "functions.h"
#include "minding.h"

/* out = A x */
static void multiply(int n, const double *A, const double *x, double *out) {
    for (int i = 0; i < n; i++) {
        double sum = 0.0;
        for (int j = 0; j < n; j++) sum += A[n * i + j] * x[j];
        out[i] = sum;
    }
}

static int finite_numbers(const double *x, int n) {
    for (int i = 0; i < n; i++)
        if (!isfinite(x[i])) return 0;
    return 1;
}

/* Largest norm of one half of twists or wrenches: the first three numbers, or the last three. */
static double largest_norm(int arms, const double *x, int part) {
    double most = 0.0;
    for (int k = 0; k < arms; k++) most = maximum(most, dot3(x + 6 * k + 3 * part, x + 6 * k + 3 * part));
    return sqrt(most);
}

/* Largest entry, in the same way. */
static double largest_entry(int arms, const double *x, int part) {
    double most = 0.0;
    for (int k = 0; k < arms; k++)
        for (int i = 0; i < 3; i++) most = maximum(most, fabs(x[6 * k + 3 * part + i]));
    return most;
}

/* Take wrenches (6 N; nullptr for none) after a time. HEARD: all came; MISSED: some did not; SILENT: one has been missing
 * for too long, or has not changed by a bit for as long while the arms move. */
static Hearing feel(int arms, const MindingArrays *f, const double *wrenches, double dt) {
    const int n = 6 * arms;
    Minding *m = f->m;
    double *silent = f->silent, *seen = f->seen, *internal = f->internal;
    const double share = dt / (dt + m->wrench_filter);
    const int moves = m->last_speed > SENSED_MOTION;
    Hearing heard = HEARD;
    for (int k = 0; k < arms; k++) {
        const int fresh = wrenches && finite_numbers(wrenches + 6 * k, 6);
        const int same = fresh && moves && !memcmp(seen + 6 * k, wrenches + 6 * k, 6 * sizeof(double));
        if (fresh) memcpy(seen + 6 * k, wrenches + 6 * k, 6 * sizeof(double));
        else heard = heard == SILENT ? SILENT : MISSED;
        silent[k] = fresh && !same ? 0.0 : silent[k] + dt;
        if (silent[k] > m->wrench_silence) heard = SILENT;
    }
    double squares = 0.0;
    m->sharpest = 0.0;
    for (int i = 0; i < n; i++) {
        double now = -f->target[i];
        for (int j = 0; j < n; j++) now += f->internal_of[n * i + j] * seen[j];
        internal[i] += share * (now - internal[i]);
        squares = (i % 6 == 0 ? 0.0 : squares) + (i % 6 < 3 ? now * now : 0.0);
        m->sharpest = fmax(m->sharpest, sqrt(squares));
        f->felt[i] += share * (seen[i] - f->felt[i]);
    }
    m->size = maximum(largest_norm(arms, internal, 0), largest_norm(arms, internal, 1) / TURN_LENGTH);
    return heard;
}

/* The share of its full rate at which the path asks the grasps to move on: a step to its end says 1 again, however slow it came. */
static double share_of_way(const Minding *m, double rate) { return minimum(rate, m->allowed); }

/* A slow object shows little of its drift, which would be learned with the square of the rate. */
static double square_of_slow(double rate) {
    const double counts = clamp(rate, SLOWEST_LESSON, 1.0);
    return counts * counts;
}

/* Move the grasps by one step of dt, while the object moves at a rate. */
static void give_way(int arms, const MindingArrays *f, double dt, double rate) {
    const int n = 6 * arms;
    Minding *m = f->m;
    double *shift = f->shift, *drift = f->drift, way[6 * (int)MOST_MINDING], moved[6 * (int)MOST_MINDING];
    const double size = m->size, soft = clamp(m->stiffer, SOFTEST, 1.0), asks = share_of_way(m, rate);
    if (size > m->dead_band) {
        const double gain = (m->dead_band / size - 1.0) / (maximum(m->stiffer, 1.0) * m->relax_time);
        /* Softer servos than given are answered more slowly, and their drift is learned more slowly in the same proportion. */
        const double learned = rate * dt * soft / (square_of_slow(rate) * m->drift_time);
        multiply(n, f->yields, f->internal, way);
        for (int i = 0; i < n; i++) way[i] *= gain, drift[i] += learned * way[i];
    } else {
        memset(way, 0, (size_t)n * sizeof(double));
    }
    if (m->at_end != 0.0) /* soft servos, and slow objects, would unlearn slowly what the path has asked for */
        for (int i = 0; i < n; i++) drift[i] *= 1.0 - rate * dt * (1.0 - soft * asks) / (m->drift_time + dt);
    for (int i = 0; i < n; i++) way[i] += asks * drift[i];
    double fastest = maximum(largest_entry(arms, way, 0) / m->most_speed, largest_entry(arms, way, 1) / m->most_spin);
    fastest = maximum(fastest, 1.0);
    m->relax_ease = minimum(m->relax_ease + dt / m->ramp_time, 1.0);
    for (int i = 0; i < n; i++) moved[i] = shift[i] + dt * m->relax_ease / fastest * way[i];
    const double far = maximum(largest_norm(arms, moved, 0) / m->most_reach, largest_norm(arms, moved, 1) / m->most_turn);
    m->saturated = far >= 1.0 - 1e-9; /* also where it rests at the end of its reach, to rounding */
    for (int i = 0; i < n; i++) shift[i] = far > 1.0 ? moved[i] / far : moved[i];
}

/* Palms press, and all forces are small, for long enough: then the object moves, slowly at first on servos that were found to
 * be other ones than told. */
static void wait_at_rest(Minding *m, double dt) {
    m->since = m->size > m->pressed_below ? 0.0 : m->since + dt;
    if (!(m->since > m->wait && m->size < m->move_below)) return;
    m->stage = MOVING, m->since = 0.0;
    const int softer = m->stiffer > SOFTEST && m->stiffer * STRANGE_SERVOS < 1.0; /* or they do not answer at all */
    if (m->has_palms == 0.0 && (softer || m->stiffer > STRANGE_SERVOS)) /* the pads of palms yield, too */
        m->force_cap = minimum(m->force_cap, CAREFUL_START);
}

/* The object is led to its path once the arms have relaxed: before, that would be a pull of its own. */
static void begin_to_correct(Minding *m, double dt) {
    if (m->stage == MOVING) m->corrects = minimum(m->corrects + dt / CORRECTION_FADES, 1.0);
}

/* An object that has met something goes back the way that it came, which is free; a resting one the way it is pushed. As fast as
 * it came, at first as far as it went before that was known. */
static void turn_back(Minding *m, const double *velocity, const double *off, double *back) {
    const double speed = sqrt(dot3(velocity, velocity)), size = sqrt(dot3(off, off));
    const int against = -dot3(velocity, off) >= HEAD_ON * speed * size && speed > 0.0;
    for (int i = 0; i < 3; i++) back[i] = against ? velocity[i] / -speed : off[i] / fmax(size, 1e-12);
    m->back_speed = maximum(speed, CONTACT_BACK);
    m->back_owed = speed * m->contact_late, m->back_from = NAN, m->goes_on = 0.0;
}

/* `backs`, the speed at which the object goes back now: until nothing pushes it any more. */
static void go_back(Minding *m, const double *off, const double *back, double dt) {
    const double most = m->back_speed * dt;
    if (dot3(back, off) >= LET_GO * m->contact_limit) m->back_owed = maximum(m->back_owed, most);
    const double way = minimum(m->back_owed, most);
    m->back_owed -= way, m->backs = way / dt;
}

/* What pushes the object, beside its weight and the arms: the sum of their wrenches, less its weight and inertia. What was
 * there before it moved is no contact, nor any less of it: a payload of another mass, or a table that it is lifted from. */
static void contact(int arms, const MindingArrays *f, double dt) {
    const int n = 6 * arms;
    Minding *m = f->m;
    double *travel = f->travel, *push = f->push, *base = push + 3, force[3] = {0.0, 0.0, 0.0}, place[3], sum[3];
    const double settled = dt / (dt + CONTACT_SETTLES), fresh = dt / (dt + CONTACT_FILTER);
    const double weight[3] = {m->weight_x, m->weight_y, m->weight_z}, since = fmax(m->reference_dt, 1e-6);
    if (!(m->contact_limit < INFINITY)) return;
    rotate(f->reference, f->centre, place);
    for (int i = 0; i < 3; i++) place[i] += f->reference[9 + i];
    if (m->stage < MOVING) {
        memcpy(travel, place, sizeof place);
        memset(travel + 3, 0, 6 * sizeof(double));
        m->load_haste = 0.0;
    } else {
        double square = 0.0, speed = 0.0;
        for (int i = 0; i < 3; i++) {
            const double velocity = (place[i] - travel[i]) / since, change = (velocity - travel[3 + i]) / since;
            travel[i] = place[i], travel[3 + i] = velocity;
            travel[6 + i] += dt / (dt + m->wrench_filter) * (change - travel[6 + i]);
            square += change * change, speed += velocity * velocity;
        }
        m->load_speed = fmax(sqrt(speed), m->load_speed * PUSHES_FADE / (PUSHES_FADE + dt));
        m->load_haste = fmax(sqrt(square), m->load_haste * SERVO_PEAK / (SERVO_PEAK + dt));
    }
    for (int k = 0; k < arms; k++)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 6; j++) force[i] += f->unfed_of[n * (6 * k + i) + 6 * k + j] * f->seen[6 * k + j];
    rotate(f->reference, force, sum);
    for (int i = 0; i < 3; i++) {
        const double now = weight[i] + m->load_mass * travel[6 + i] - sum[i];
        push[i] += fresh * (now - push[i]);
        if (m->stage < MOVING) base[i] += settled * (now - base[i]);
    }
    if (m->stage < MOVING) return;
    const double share = clamp(dot3(push, base) / fmax(dot3(base, base), 1e-12), 0.0, 1.0);
    for (int i = 0; i < 3; i++) sum[i] = push[i] - share * base[i];
    m->pushed = sqrt(dot3(sum, sum));
    const double limit = (m->touches != 0.0 ? LET_GO : 1.0) * m->contact_limit;
    const int clear = m->touches != 0.0 || (m->suspected == 0.0 && m->pushed > MORE_THAN_INTERNAL * m->sharpest);
    double *impulse = push + 12;
    for (int i = 0; i < 3; i++) {
        impulse[i] *= PUSHES_FADE / (PUSHES_FADE + dt);
        if (m->pushed >= m->contact_limit) impulse[i] += dt * sum[i];
    }
    const double stops = MORE_THAN_STOPPED * m->load_mass * m->load_speed + PUSHED_FOR * m->contact_limit;
    if ((clear || dot3(impulse, impulse) > stops * stops) && m->pushed - LATE_LOAD * m->load_mass * m->load_haste >= limit) {
        if (m->touches <= UNTIL_TOLD) {
            turn_back(m, travel + 3, sum, push + 9);
            memset(push + 6, 0, sizeof sum);
        }
        if (dot3(sum, sum) > dot3(push + 6, push + 6)) memcpy(push + 6, sum, sizeof sum);
        m->touches = CONTACT_LASTS;
    } else if (m->touches != 0.0) {
        m->touches = maximum(m->touches - dt, m->goes_on != 0.0 ? 0.0 : UNTIL_TOLD);
    }
    m->backs = 0.0;
    if (m->touches == 0.0) return;
    m->corrects = m->force_cap = 0.0;
    go_back(m, sum, push + 9, dt);
}

/* Take wrenches, and move the grasps where they give way. Returns HEARD, MISSED or SILENT. */
static Hearing relax(int arms, Minding *m, const double *wrenches, double dt) {
    const MindingArrays f = minding_of(arms, m);
    const int gives = gives_way(m);
    const Hearing heard = feel(arms, &f, wrenches, dt);
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
    contact(arms, &f, dt);
    if (m->stage < RELAXING) m->start_size = maximum(m->start_size, m->size);
    if (gives && m->backs == 0.0) /* what pushes the object also pushes the arms against each other */
        give_way(arms, &f, dt, m->stage == MOVING ? m->last_rate : 0.0);
    if (m->stage == RELAXING && m->sensor_fault == SENSORS_FINE) wait_at_rest(m, dt);
    return heard;
}
