/* How fast the object may move for the forces: not at all before the arms have relaxed, more slowly where an internal
 * force grows or a palm's friction runs out. allow_plain.py says the same in NumPy. */

#include "functions.h"
#include "minding.h"

/* Share of a bound |A w| ≤ b·w of a palm that is used. */
static double share_used(const double *bound, const double *w) {
    double asked = 0.0, held = 0.0;
    for (int i = 0; i < 3; i++) {
        double sum = 0.0;
        for (int j = 0; j < 6; j++) sum += bound[6 * i + j] * w[j];
        asked += sum * sum;
    }
    for (int j = 0; j < 6; j++) held += bound[18 + j] * w[j];
    return held > 0.0 ? sqrt(asked) / held : INFINITY;
}

/* The busiest palm's use, and which it is; the normal force that all would need. */
static double palms_used(int arms, const Minding *f, int *busiest, double *needed) {
    double most = -1.0;
    *needed = 0.0, *busiest = 0;
    for (int k = 0; k < arms; k++) {
        const double *palm = f->palms + PALM * k, *w = f->seen + 6 * k;
        const double used = maximum(share_used(palm, w), share_used(palm + PALM_BOUND, w));
        double pressed = 0.0;
        for (int j = 0; j < 6; j++) pressed += palm[PALM - 6 + j] * w[j];
        *needed = maximum(*needed, pressed > 0.0 ? used * pressed : INFINITY);
        if (used > most) most = used, *busiest = k;
    }
    return most;
}

/* Raise the squeeze where the load that is felt needs more; it never falls again. */
static void press_harder(int arms, const Minding *f, double needed, double dt) {
    double *m = f->m;
    m[NEEDED] += dt / (dt + m[WRENCH_FILTER]) * (minimum(needed, m[MOST_SQUEEZE]) - m[NEEDED]);
    const double wanted = minimum(SPARE_SQUEEZE * m[NEEDED], m[MOST_SQUEEZE]);
    if (!(wanted > m[PRESSED_WITH])) return;
    m[PRESSED_WITH] = minimum(wanted, m[PRESSED_WITH] + FIRMER * dt);
    for (int i = 0; i < 6 * arms; i++) f->target[i] = m[PRESSED_WITH] / m[SQUEEZE] * f->squeezed[i];
}

/* Let the rate that forces allow come closer to `cap`: it falls in proportion to itself, as braking makes forces of its own, and
 * rises the less, the more is felt, and the stiffer the servos are. */
static void ease_cap(double *m, double cap, double dt) {
    const double falls = maximum(m[FORCE_CAP], SLOW_RATE) / RATE_FALLS;
    const double calm = maximum(1.0 - m[SIZE] / m[FORCE_SLOWS], LEAST_CALM) / sqrt(maximum(m[STIFFER], 1.0));
    m[FORCE_CAP] = minimum(maximum(cap, m[FORCE_CAP] - falls * dt), m[FORCE_CAP] + calm * dt / RATE_RISES);
}

/* Whether friction is what slows the object. */
static int friction_slows(int arms, const Minding *f, double dt) {
    double *m = f->m, needed;
    int busiest;
    const double used = palms_used(arms, f, &busiest, &needed);
    press_harder(arms, f, needed, dt);
    m[FRICTION_USED] += dt / (dt + m[WRENCH_FILTER]) * (minimum(used, 2.0) - m[FRICTION_USED]);
    if (!(m[FRICTION_USED] > FRICTION_SLOWS)) return 0;
    ease_cap(m, maximum((1.0 - m[FRICTION_USED]) / (1.0 - FRICTION_SLOWS), 0.0), dt);
    m[WHY_ARM] = busiest;
    return 1;
}

/* Find the largest rate of the object now, ALLOWED, and WHY it is less than the wanted rate. */
static void allow(int arms, double *memory, double dt) {
    const Minding f = minding_of(arms, memory);
    double *m = memory;
    int why = NOTHING_MORE;
    if (m[SENSOR_FAULT] != SENSORS_FINE) why = BY_SENSOR;
    else if (m[TOUCHES] != 0.0) why = BY_CONTACT;
    else if (m[SATURATED] != 0.0 && m[SIZE] > m[FORCE_SLOWS]) why = BY_REACH;
    else if (m[STAGE] != MOVING) why = BY_STAGE;
    m[WHY] = why, m[ALLOWED] = 0.0;
    if (why != NOTHING_MORE) return;
    if (m[HAS_PALMS] != 0.0 && friction_slows(arms, &f, dt)) {
        m[WHY] = BY_FRICTION, m[ALLOWED] = minimum(m[FORCE_CAP], m[ASKED]);
        return;
    }
    ease_cap(m, clamp((m[FORCE_HOLDS] - m[SIZE]) / (m[FORCE_HOLDS] - m[FORCE_SLOWS]), 0.0, 1.0), dt);
    m[WHY] = m[FORCE_CAP] >= m[ASKED] ? NOTHING_MORE : BY_FORCE;
    m[ALLOWED] = minimum(m[FORCE_CAP], m[ASKED]);
}
