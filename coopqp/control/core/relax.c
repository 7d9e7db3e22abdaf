/* The relaxation of forces, one step of it: the filter on wrenches, and how the grasps give way. relax_plain.py says the
 * same in NumPy, coopqp/forces/relaxation.py says why. The memory is that of layout.RELAX, for N arms: the scalars, then
 * silent (N), seen, internal, shift, drift, target (6 N each), internal_of and yields (6 N, 6 N). `internal` is what the
 * internal wrenches have beside the target. */

#include "functions.h"

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

/* Largest norm of the halves of twists or wrenches: of the first three numbers, or of the last three. */
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

/* Take wrenches (6 N; NULL where none came) after a time. HEARD: all came; MISSED: some did not; SILENT: one has not come
 * for too long. */
static int feel(int arms, double *m, const double *wrenches, double dt) {
    const int n = 6 * arms;
    double *silent = m + N_RELAX, *seen = silent + arms, *internal = seen + n;
    const double *target = internal + 3 * n, *internal_of = target + n, share = dt / (dt + m[WRENCH_FILTER]);
    int heard = HEARD;
    for (int k = 0; k < arms; k++) {
        const int fresh = wrenches && finite_numbers(wrenches + 6 * k, 6);
        if (fresh) memcpy(seen + 6 * k, wrenches + 6 * k, 6 * sizeof(double));
        else heard = heard == SILENT ? SILENT : MISSED;
        silent[k] = fresh ? 0.0 : silent[k] + dt;
        if (silent[k] > m[WRENCH_SILENCE]) heard = SILENT;
    }
    for (int i = 0; i < n; i++) {
        double now = -target[i];
        for (int j = 0; j < n; j++) now += internal_of[n * i + j] * seen[j];
        internal[i] += share * (now - internal[i]);
    }
    m[SIZE] = maximum(largest_norm(arms, internal, 0), largest_norm(arms, internal, 1) / TURN_LENGTH);
    return heard;
}

/* Move the grasps by one step of dt, while the object moves at a rate. `work` has room for 12 N. */
static void give_way(int arms, double *m, double dt, double rate, double *work) {
    const int n = 6 * arms;
    double *internal = m + N_RELAX + arms + n, *shift = internal + n, *drift = shift + n;
    double *way = work, *moved = work + n;
    const double *yields = drift + 2 * n + (size_t)(n * n), size = m[SIZE];
    if (size > m[DEAD_BAND]) {
        const double gain = (m[DEAD_BAND] / size - 1.0) / (m[STIFFER] * m[RELAX_TIME]);
        multiply(n, yields, internal, way);
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
