/* The relaxation of forces, one step of it: the filter on wrenches, and how the grasps give way. relax_plain.py says the
 * same in NumPy, coopqp/forces/relaxation.py says why. */

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

/* Take wrenches (6 N; NULL for none) after a time. HEARD: all came; MISSED: some did not; SILENT: one has been missing
 * for too long. */
static int feel(int arms, const Minding *f, const double *wrenches, double dt) {
    const int n = 6 * arms;
    double *m = f->m, *silent = f->silent, *seen = f->seen, *internal = f->internal;
    const double share = dt / (dt + m[WRENCH_FILTER]);
    int heard = HEARD;
    for (int k = 0; k < arms; k++) {
        const int fresh = wrenches && finite_numbers(wrenches + 6 * k, 6);
        if (fresh) memcpy(seen + 6 * k, wrenches + 6 * k, 6 * sizeof(double));
        else heard = heard == SILENT ? SILENT : MISSED;
        silent[k] = fresh ? 0.0 : silent[k] + dt;
        if (silent[k] > m[WRENCH_SILENCE]) heard = SILENT;
    }
    for (int i = 0; i < n; i++) {
        double now = -f->target[i];
        for (int j = 0; j < n; j++) now += f->internal_of[n * i + j] * seen[j];
        internal[i] += share * (now - internal[i]);
    }
    m[SIZE] = maximum(largest_norm(arms, internal, 0), largest_norm(arms, internal, 1) / TURN_LENGTH);
    return heard;
}

/* Move the grasps by one step of dt, while the object moves at a rate. */
static void give_way(int arms, const Minding *f, double dt, double rate) {
    const int n = 6 * arms;
    double *m = f->m, *shift = f->shift, *drift = f->drift, way[6 * (int)MOST_MINDING], moved[6 * (int)MOST_MINDING];
    const double size = m[SIZE];
    if (size > m[DEAD_BAND]) {
        const double gain = (m[DEAD_BAND] / size - 1.0) / (m[STIFFER] * m[RELAX_TIME]);
        multiply(n, f->yields, f->internal, way);
        for (int i = 0; i < n; i++) way[i] *= gain, drift[i] += rate * dt / m[DRIFT_TIME] * way[i];
    } else {
        memset(way, 0, (size_t)n * sizeof(double));
    }
    for (int i = 0; i < n; i++) way[i] += rate * drift[i];
    double fastest = maximum(largest_entry(arms, way, 0) / m[MOST_SPEED], largest_entry(arms, way, 1) / m[MOST_SPIN]);
    fastest = maximum(fastest, 1.0);
    m[RELAX_EASE] = minimum(m[RELAX_EASE] + dt / m[RAMP_TIME], 1.0);
    for (int i = 0; i < n; i++) moved[i] = shift[i] + dt * m[RELAX_EASE] / fastest * way[i];
    const double far = maximum(largest_norm(arms, moved, 0) / m[MOST_REACH], largest_norm(arms, moved, 1) / m[MOST_TURN]);
    m[SATURATED] = far >= 1.0;
    for (int i = 0; i < n; i++) shift[i] = far > 1.0 ? moved[i] / far : moved[i];
}

/* Palms press, and all forces are small, for long enough: then the object moves. */
static void wait_at_rest(double *m, double dt) {
    m[SINCE] = m[SIZE] > m[PRESSED_BELOW] ? 0.0 : m[SINCE] + dt;
    if (m[SINCE] > m[WAIT] && m[SIZE] < m[MOVE_BELOW]) m[STAGE] = MOVING, m[SINCE] = 0.0;
}

/* Take wrenches, and move the grasps where they give way. Returns HEARD, MISSED or SILENT. */
static int relax(int arms, double *memory, const double *wrenches, double dt) {
    const Minding f = minding_of(arms, memory);
    double *m = memory;
    const int gives = gives_way(m), heard = feel(arms, &f, wrenches, dt);
    m[AGE] += dt;
    if (heard == SILENT) {
        if (m[SENSOR_FAULT] != SENSORS_FINE) return heard;
        int most = 0;
        for (int k = 1; k < arms; k++)
            if (f.silent[k] > f.silent[most]) most = k;
        m[SENSOR_FAULT] = SENSOR_SILENT, m[SENSOR_ARM] = most, m[SENSOR_AMOUNT] = f.silent[most];
        return heard;
    }
    if (gives) give_way(arms, &f, dt, m[STAGE] == MOVING ? m[LAST_RATE] : 0.0);
    if (m[STAGE] == RELAXING && m[SENSOR_FAULT] == SENSORS_FINE) wait_at_rest(m, dt);
    return heard;
}
