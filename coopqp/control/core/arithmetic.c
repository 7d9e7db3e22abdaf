/* The arithmetic of the fused step, the same as in reference.py, over the memory of a Workspace; no Python, no Pinocchio.
 *
 * See workspace.py for what each array is. Any NaN fails a comparison written as "not inside", so non-finite data come
 * out as OPEN. Compiled once for any processor and, where ARITHMETIC names another table, once more for a newer one. */

#include "arithmetic.h"

#include <math.h>
#include <string.h>

#ifndef ARITHMETIC
#define ARITHMETIC arithmetic_plain
#endif

#define LIMIT_TOLERANCE 1e-9
#define STILL 1e-12
#define SMALLEST_PIVOT 1e-9
/* Beyond this an inverse needs its singular values looked at, as in chain.py. */
#define LARGE_INVERSE 1e4
/* As VelocityBox.RECOVERY_SHARE and VelocityBox.INSIDE. */
#define RECOVERY_SHARE 0.2
#define INSIDE 1e-5

/* -- three-vectors and rotations ---------------------------------------------------------------------------------- */

static void cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static double dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* log of a placement given by Rᵀ (row major) and p. Returns 0 near half a turn, where the caller must do otherwise. */
static int log6(const double *RT, const double *p, double *e) {
    double w[3] = {0.5 * (RT[5] - RT[7]), 0.5 * (RT[6] - RT[2]), 0.5 * (RT[1] - RT[3])};
    double s2 = dot3(w, w), c = 0.5 * (RT[0] + RT[4] + RT[8] - 1.0);
    double ratio, third; /* θ / sin θ, and (1 − θ cot(θ/2) / 2) / θ² */
    if (!(c > -0.9)) return 0;
    if (s2 < 4e-4 && c > 0.0) {
        ratio = 1.0 + s2 * (1.0 / 6 + s2 * (3.0 / 40 + s2 * (5.0 / 112)));
        double t2 = s2 * ratio * ratio;
        third = 1.0 / 12 + t2 * (1.0 / 720 + t2 / 30240);
    } else {
        double s = sqrt(s2), theta = atan2(s, c);
        ratio = theta / s;
        third = (1.0 - 0.5 * theta * s / (1.0 - c)) / (theta * theta);
    }
    double *omega = e + 3, wp[3], wwp[3];
    for (int i = 0; i < 3; i++) omega[i] = ratio * w[i];
    cross(omega, p, wp);
    cross(omega, wp, wwp);
    for (int i = 0; i < 3; i++) e[i] = p[i] - 0.5 * wp[i] + third * wwp[i];
    return 1;
}

/* -- linear algebra: one small system, several right-hand sides ---------------------------------------------------- */

/* Two numbers side by side, as GCC and Clang know them; other compilers leave it to the NumPy step. */
typedef double pair __attribute__((vector_size(16)));
/* Rows of [A | b₀ b₁]: a system of six, and two right-hand sides; entry (i, j) is rows[i][j / 2][j % 2]. */
typedef pair Rows[6][4];
#define UNROLL _Pragma("GCC unroll 6")

/* Solve by elimination with partial pivoting; the answers take the right-hand sides' place. 0 if singular. */
static int solve6(Rows A) {
    double scale = 0.0, inverse[6];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            double size = fabs(A[i][j / 2][j % 2]);
            scale = size > scale ? size : scale;
        }
    UNROLL for (int k = 0; k < 6; k++) {
        int first = k / 2, pivot = k;
        double largest = fabs(A[k][first][k % 2]);
        UNROLL for (int i = k + 1; i < 6; i++) {
            double size = fabs(A[i][first][k % 2]);
            pivot = size > largest ? i : pivot;
            largest = size > largest ? size : largest;
        }
        if (!(largest > SMALLEST_PIVOT * scale)) return 0;
        if (pivot != k)
            for (int j = first; j < 4; j++) {
                pair other = A[pivot][j];
                A[pivot][j] = A[k][j];
                A[k][j] = other;
            }
        inverse[k] = 1.0 / A[k][first][k % 2];
        UNROLL for (int i = k + 1; i < 6; i++) {
            double f = A[i][first][k % 2] * inverse[k];
            for (int j = first; j < 4; j++) A[i][j] -= (pair){f, f} * A[k][j];
        }
    }
    UNROLL for (int k = 5; k >= 0; k--) {
        pair x = A[k][3];
        UNROLL for (int j = k + 1; j < 6; j++) {
            double f = A[k][j / 2][j % 2];
            x -= (pair){f, f} * A[j][3];
        }
        A[k][3] = x * (pair){inverse[k], inverse[k]};
    }
    return 1;
}

/* Joint velocities v (2, n) of one arm with n ≥ 6 joints for two world twists w (2, 6), near the null-space wishes
 * u (2, n) for a redundant arm: v = u + A⁺(w − J u), A⁺ the right inverse of least Σ (v/scale)². JT is (n, 6). */
static int arm_velocities(const double *JT, const double *scale, int n, const double *w, const double *u, double *v) {
    Rows A;
    if (n == 6) {
        for (int i = 0; i < 6; i++) {
            for (int j = 0; j < 3; j++) A[i][j] = (pair){JT[12 * j + i], JT[12 * j + 6 + i]};
            A[i][3] = (pair){w[i], w[6 + i]};
        }
        if (!solve6(A)) return 0;
        for (int j = 0; j < 6; j++) {
            v[j] = A[j][3][0];
            v[6 + j] = A[j][3][1];
        }
        return 1;
    }
    for (int i = 0; i < 6; i++) {
        for (int k = 0; k <= i; k++) {
            double sum = 0.0;
            for (int j = 0; j < n; j++) sum += JT[6 * j + i] * JT[6 * j + k] * scale[j] * scale[j];
            A[i][k / 2][k % 2] = A[k][i / 2][i % 2] = sum;
        }
        for (int c = 0; c < 2; c++) {
            double rest = w[6 * c + i];
            for (int j = 0; j < n; j++) rest -= JT[6 * j + i] * u[n * c + j];
            A[i][3][c] = rest;
        }
    }
    if (!solve6(A)) return 0;
    for (int j = 0; j < n; j++)
        for (int c = 0; c < 2; c++) {
            double sum = 0.0;
            for (int i = 0; i < 6; i++) sum += JT[6 * j + i] * A[i][3][c];
            v[n * c + j] = u[n * c + j] + scale[j] * scale[j] * sum;
        }
    return 1;
}

/* e_k = log(R⁻¹ O_k), O_k = T_world_joint Y_k; the rows of placements and Y are transposed. */
static int errors(Kernel *k) {
    const double *R = D(k, B_R), *p = D(k, B_P);
    for (int a = 0; a < k->arms; a++) {
        const double *Y = D(k, B_Y) + 16 * a, *M = D(k, B_PLACEMENTS) + 12 * L(k, B_JOINTS)[a];
        double O[12], E[12];
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 3; j++) {
                double sum = i == 3 ? M[9 + j] : 0.0;
                for (int m = 0; m < 3; m++) sum += Y[4 * i + m] * M[3 * m + j];
                O[3 * i + j] = sum;
            }
        for (int j = 0; j < 3; j++) O[9 + j] -= p[j];
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 3; j++)
                E[3 * i + j] = O[3 * i] * R[j] + O[3 * i + 1] * R[3 + j] + O[3 * i + 2] * R[6 + j];
        if (!log6(E, E + 9, D(k, B_ERRORS) + 6 * a)) return 0;
    }
    return 1;
}

/* Shrink n corrections by one common factor to the bounds of speed and spin. */
static void bound(double *c, int n, double speed, double spin) {
    double linear = 0.0, angular = 0.0;
    for (int a = 0; a < n; a++) {
        double way = dot3(c + 6 * a, c + 6 * a), turn = dot3(c + 6 * a + 3, c + 6 * a + 3);
        linear = way > linear ? way : linear;
        angular = turn > angular ? turn : angular;
    }
    double excess = fmax(sqrt(linear) / speed, sqrt(angular) / spin);
    for (int i = 0; excess > 1.0 && i < 6 * n; i++) c[i] /= excess;
}

/* The object's error: that of the arms by their shares. */
static void common_error(Kernel *k) {
    const double *shares = D(k, B_SHARES), *errors = D(k, B_ERRORS);
    double common[6] = {0};
    for (int a = 0; a < k->arms; a++)
        for (int i = 0; i < 6; i++) common[i] += shares[6 * a + i] * errors[6 * a + i];
    memcpy(D(k, B_COMMON), common, sizeof common);
}

static void corrections(Kernel *k) {
    const double *s = D(k, B_SCALARS), *errors = D(k, B_ERRORS), *foreseen = D(k, B_PREDICTED), *common = D(k, B_COMMON);
    double *grasp = D(k, B_GRASP), *path = D(k, B_PATH), *offsets = D(k, B_OFFSETS);
    const double gain = -s[GRASP_GAIN], rate = 1.0 / s[LAST_DT];
    common_error(k);
    for (int a = 0; a < k->arms; a++)
        for (int i = 0; i < 6; i++) {
            double e = errors[6 * a + i];
            grasp[6 * a + i] = gain * (e - common[i]);
            offsets[6 * a + i] = s[HAS_PREDICTED] != 0.0 ? (foreseen[6 * a + i] - e) * rate : 0.0;
        }
    for (int i = 0; i < 6; i++) path[i] = -s[PATH_GAIN] * (s[HAS_MEASURED] != 0.0 ? D(k, B_MEASURED)[i] : common[i]);
    bound(grasp, k->arms, s[SPEED], s[SPIN]);
    bound(path, 1, s[SPEED], s[SPIN]);
    D(k, B_RESULT)[3] = dot3(path, path) + dot3(path + 3, path + 3);
}

/* A twist of the reference object frame, in the world: Ad(R) w. */
static void to_world(const double *R, const double *p, const double *w, double *out) {
    double swept[3];
    for (int i = 0; i < 3; i++) {
        out[i] = dot3(R + 3 * i, w);
        out[3 + i] = dot3(R + 3 * i, w + 3);
    }
    cross(p, out + 3, swept);
    for (int i = 0; i < 3; i++) out[i] += swept[i];
}

/* Nominal command, and what a unit of rate contributes. */
static int command(Kernel *k, double cap) {
    const double *R = D(k, B_R), *p = D(k, B_P), *along = D(k, B_ALONG), *path = D(k, B_PATH);
    const double *grasp = D(k, B_GRASP), *offsets = D(k, B_OFFSETS);
    double common[6], W[12], U[2 * MAX_JOINTS], V[2 * MAX_JOINTS];
    for (int i = 0; i < 6; i++) common[i] = cap * along[i] + path[i];
    to_world(R, p, along, W + 6);
    for (int a = 0; a < k->arms; a++, grasp += 6, offsets += 6) {
        int n = (int)L(k, B_SIZES)[a], start = (int)L(k, B_STARTS)[a];
        double w[6];
        for (int i = 0; i < 6; i++) w[i] = common[i] + grasp[i] + offsets[i];
        to_world(R, p, w, W);
        for (int j = 0; n > 6 && j < n; j++) {
            U[n + j] = D(k, B_NULL_ALONG)[start + j];
            U[j] = cap * U[n + j] + D(k, B_NULL_OFFSET)[start + j];
        }
        if (!arm_velocities(D(k, B_JACOBIAN) + 6 * start, D(k, B_SCALE) + start, n, W, U, V)) return 0;
        memcpy(D(k, B_VELOCITY) + start, V, sizeof(double) * (size_t)n);
        memcpy(D(k, B_ALONG_VELOCITY) + start, V + n, sizeof(double) * (size_t)n);
    }
    return 1;
}

static double clamp(double x, double low, double high) { return x < low ? low : (x > high ? high : x); }

/* Largest speed from which distance d ≥ 0 suffices to stop; see VelocityBox. */
static double stopping_speed(double d, double a, double h, int accelerates) {
    if (!accelerates || !isfinite(a) || !isfinite(d)) return d / h;
    double step = a * h;
    return 2.0 * a * d / (sqrt(step * step + 2.0 * a * d) + step);
}

/* The box of VelocityBox.update. Returns 0 if a joint is outside a position limit. */
static int box(Kernel *k) {
    const double h = D(k, B_SCALARS)[DT];
    int inside = 1;
    for (int j = 0; j < k->joints; j++) {
        double x = D(k, B_POSITIONS)[j], up = D(k, B_HIGH)[j] - x, down = x - D(k, B_LOW)[j];
        double a = D(k, B_ACCELERATION)[j], speed = D(k, B_MAXSPEED)[j], v = D(k, B_VPREV)[j];
        if (!(up >= 0.0 && down >= 0.0 && isfinite(v))) inside = 0;
        double upper = fmin(speed, stopping_speed(fmax(up, 0.0), a, h, k->accelerates));
        double lower = -fmin(speed, stopping_speed(fmax(down, 0.0), a, h, k->accelerates));
        if (k->accelerates) {
            upper = clamp(upper, v - a * h, v + a * h);
            lower = clamp(lower, v - a * h, v + a * h);
        }
        D(k, B_UPPER)[j] = upper;
        D(k, B_LOWER)[j] = lower;
    }
    return inside;
}

/* Whether the command stays inside all limits, from inside and without a need to clip: the box without its divisions. */
static int well_inside(const Kernel *k) {
    const double h = D(k, B_SCALARS)[DT], *velocity = D(k, B_VELOCITY), *v_prev = D(k, B_VPREV);
    const double *x = D(k, B_POSITIONS), *low = D(k, B_LOW), *high = D(k, B_HIGH), *fastest = D(k, B_MAXSPEED);
    const double *acceleration = D(k, B_ACCELERATION), *per_acceleration = D(k, B_PER_ACCELERATION);
    int inside = 1;
    for (int j = 0; j < k->joints; j++) {
        double v = velocity[j], speed = fabs(v), up = high[j] - x[j], down = x[j] - low[j];
        double way = speed * h + speed * speed * per_acceleration[j], room = v > 0.0 ? up : down;
        double change = fabs(v - v_prev[j]);
        inside &= (way <= room) & (up >= 0.0) & (down >= 0.0) & (speed <= fastest[j]) &
                  (change <= acceleration[j] * h) & (change < INFINITY);
    }
    return inside;
}

static int admissible(Kernel *k) {
    for (int j = 0; j < k->joints; j++) {
        double v = D(k, B_VELOCITY)[j];
        if (!(v <= D(k, B_UPPER)[j] + LIMIT_TOLERANCE && v >= D(k, B_LOWER)[j] - LIMIT_TOLERANCE)) return 0;
    }
    return 1;
}

static void clip(Kernel *k) {
    for (int j = 0; j < k->joints; j++)
        D(k, B_VELOCITY)[j] = clamp(D(k, B_VELOCITY)[j], D(k, B_LOWER)[j], D(k, B_UPPER)[j]);
}

/* rate_interval and what follows from it; see reference.py. */
static int ray(Kernel *k, double cap) {
    double *v = D(k, B_VELOCITY), *result = D(k, B_RESULT), *along = D(k, B_ALONG_VELOCITY);
    double low = -INFINITY, high = INFINITY, low_slack = 0.0, high_slack = 0.0;
    int binding = -1;
    for (int j = 0; j < k->joints; j++) {
        double base = v[j] - cap * along[j], up = D(k, B_UPPER)[j] - base, down = D(k, B_LOWER)[j] - base;
        if (!isfinite(base)) return OPEN;
        if (fabs(along[j]) < STILL) {
            if (!(up >= -LIMIT_TOLERANCE && down <= LIMIT_TOLERANCE)) return OPEN;
            continue;
        }
        double inverse = 1.0 / along[j], slack = LIMIT_TOLERANCE * fabs(inverse);
        double first = (along[j] > 0.0 ? down : up) * inverse, last = (along[j] > 0.0 ? up : down) * inverse;
        if (last < high) high = last, high_slack = slack, binding = j;
        if (first > low) low = first, low_slack = slack;
    }
    if (low > high) {
        if (low - low_slack > high + high_slack) return OPEN;
        low = high = 0.5 * (low + high);
    }
    if (high < 0.0 && high + high_slack >= 0.0) {
        high = 0.0;
        low = fmin(low, 0.0);
    }
    if (!(high >= fmax(low, 0.0) && low <= 1.0)) return OPEN;
    double rate = fmax(cap, low);
    result[1] = -1.0;
    result[2] = 0.0;
    if (high < cap) {
        rate = high;
        result[1] = binding;
        result[2] = along[binding] > 0.0 ? 1.0 : -1.0;
    }
    result[0] = rate;
    for (int j = 0; j < k->joints; j++) {
        double x = v[j] + (rate - cap) * along[j];
        v[j] = clamp(x, D(k, B_LOWER)[j], D(k, B_UPPER)[j]);
        if (!(fabs(x - v[j]) <= 2.0 * LIMIT_TOLERANCE)) return OPEN;
    }
    return RAY;
}

/* What the next step starts from: foreseen errors, positions and velocity, and where to linearise. */
static void look_ahead(Kernel *k) {
    double *s = D(k, B_SCALARS), *x = D(k, B_POSITIONS), *v_prev = D(k, B_VPREV);
    const double h = s[DT], *v = D(k, B_VELOCITY), *errors = D(k, B_ERRORS), *path = D(k, B_PATH);
    const double *grasp = D(k, B_GRASP), *offsets = D(k, B_OFFSETS);
    double *predicted = D(k, B_PREDICTED), *midpoint = D(k, B_MIDPOINT);
    for (int a = 0; a < k->arms; a++)
        for (int i = 6 * a, m = 0; m < 6; i++, m++) predicted[i] = errors[i] + h * (grasp[i] + offsets[i] + path[m]);
    for (int j = 0; j < k->joints; j++) {
        x[j] += h * v[j];
        midpoint[j] = x[j] + 0.5 * h * (2.0 * v[j] - v_prev[j]);
        v_prev[j] = v[j];
    }
    s[HAS_PREDICTED] = 1.0;
    s[LAST_DT] = h;
}

/* Rodrigues' rotation of a rotation vector. */
static void exp3(const double *w, double *R) {
    double t2 = dot3(w, w), t = sqrt(t2), a, b; /* sin θ / θ and (1 − cos θ) / θ² */
    if (t2 < 1e-6) {
        a = 1.0 - t2 * (1.0 / 6 - t2 / 120);
        b = 0.5 - t2 * (1.0 / 24 - t2 / 720);
    } else {
        a = sin(t) / t;
        b = (1.0 - cos(t)) / t2;
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) R[3 * i + j] = b * w[i] * w[j] + (i == j ? 1.0 - b * t2 : 0.0);
    R[1] -= a * w[2], R[3] += a * w[2];
    R[2] += a * w[1], R[6] -= a * w[1];
    R[5] -= a * w[0], R[7] += a * w[0];
}

/* TimeLaw.value_at */
static double time_law(double x, double quintic) {
    if (x <= 0.0) return 0.0;
    if (x >= 1.0) return 1.0;
    double u = quintic != 0.0 ? x * x * x * (10.0 + x * (6.0 * x - 15.0)) : x;
    return u > 1.0 ? 1.0 : u; /* by rounding; a NaN stays one */
}

/* TimeLaw.slope_at */
static double time_law_slope(double x, double quintic) {
    if (x < 0.0 || x >= 1.0) return 0.0;
    return quintic != 0.0 ? 30.0 * x * x * (1.0 - x) * (1.0 - x) : 1.0;
}

/* Reference pose and ν = log(T(τ)⁻¹ T(τ + span)) / span on a LinePath; see path.py for its numbers.
 * A negative span asks for the twist at τ instead. */
static void follow_line(Kernel *k, double clock, double span) {
    const double *line = D(k, B_LINE), *turn = line + 12, *way = line + 15;
    double x = (clock - line[18]) / line[19], u = time_law(x, line[20]);
    double *R = D(k, B_R), *p = D(k, B_P), *along = D(k, B_ALONG), w[3], E[9];
    for (int i = 0; i < 3; i++) {
        w[i] = u * turn[i];
        p[i] = line[9 + i] + u * way[i];
    }
    exp3(w, E);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            R[3 * i + j] = line[3 * i] * E[j] + line[3 * i + 1] * E[3 + j] + line[3 * i + 2] * E[6 + j];
    memset(along, 0, 6 * sizeof(double));
    if (span < 0.0) { /* the twist itself */
        double rate = time_law_slope(x, line[20]) / line[19];
        for (int i = 0; i < 3; i++) {
            along[i] = rate * (R[i] * way[0] + R[3 + i] * way[1] + R[6 + i] * way[2]);
            along[3 + i] = rate * turn[i];
        }
    }
    if (span <= 0.0) return;
    double gain = time_law(x + span / line[19], line[20]) - u, step[3], omega[3], wt[3], wwt[3];
    for (int i = 0; i < 3; i++) {
        omega[i] = gain * turn[i];
        step[i] = gain * (R[i] * way[0] + R[3 + i] * way[1] + R[6 + i] * way[2]);
    }
    double t2 = dot3(omega, omega), t = sqrt(t2);
    double third = t2 < 1e-4 ? 1.0 / 12 + t2 * (1.0 / 720 + t2 / 30240) : (1.0 - 0.5 * t / tan(0.5 * t)) / t2;
    cross(omega, step, wt);
    cross(omega, wt, wwt);
    for (int i = 0; i < 3; i++) {
        along[i] = (step[i] - 0.5 * wt[i] + third * wwt[i]) / span;
        along[3 + i] = omega[i] / span;
    }
}

static int fused_step(Kernel *k, double cap, double clock, double span) {
    int outcome = NOMINAL;
    double *result = D(k, B_RESULT);
    if (D(k, B_SCALARS)[ON_LINE] != 0.0) follow_line(k, clock, span);
    if (!errors(k)) return OPEN;
    corrections(k);
    if (!command(k, cap)) return OPEN;
    result[0] = cap;
    result[1] = -1.0;
    result[2] = 0.0;
    if (!well_inside(k)) {
        if (!box(k)) return OPEN;
        if (admissible(k))
            clip(k);
        else
            outcome = ray(k, cap);
    }
    if (outcome != OPEN) look_ahead(k);
    return outcome;
}

/* Errors and their common part at the placements; 0 where they are not to be had. */
static int observe(Kernel *k, double clock) {
    if (D(k, B_SCALARS)[ON_LINE] != 0.0) follow_line(k, clock, 0.0);
    int found = errors(k);
    common_error(k);
    for (int i = 0; i < 6; i++) found = found && isfinite(D(k, B_COMMON)[i]);
    return found;
}

/* -- the condensed QP; see program.py ------------------------------------------------------------------------------ */

/* Of one arm with n ≥ 6 joints: the right inverse P (n, 6) of least Σ (v/scale)², and a basis N (n, n − 6) of what moves
 * nothing, orthonormal in the joints' units. By Householder's QR of diag(scale) Jᵀ. Returns 0 if near a singularity. */
static int right_inverse(const double *JT, const double *scale, int n, double *P, double *N) {
    double M[6 * MAX_JOINTS], Q[MAX_JOINTS * MAX_JOINTS], diagonal[6], largest = 0.0;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < 6; i++) M[6 * j + i] = scale[j] * JT[6 * j + i];
    for (int c = 0; c < 6; c++) {
        double square = 0.0;
        for (int j = c; j < n; j++) square += M[6 * j + c] * M[6 * j + c];
        double length = sqrt(square);
        if (!(length > 0.0 && isfinite(length))) return 0;
        diagonal[c] = M[6 * c + c] > 0.0 ? -length : length;
        M[6 * c + c] -= diagonal[c]; /* the reflector, of squared length 2 |d M_cc| */
        double per = -1.0 / (diagonal[c] * M[6 * c + c]);
        for (int i = c + 1; i < 6; i++) {
            double sum = 0.0;
            for (int j = c; j < n; j++) sum += M[6 * j + c] * M[6 * j + i];
            sum *= per;
            for (int j = c; j < n; j++) M[6 * j + i] -= sum * M[6 * j + c];
        }
    }
    memset(Q, 0, sizeof(double) * (size_t)(n * n)); /* row j: the j-th unit vector, reflected */
    for (int j = 0; j < n; j++) Q[n * j + j] = 1.0;
    for (int c = 0; c < 6; c++) {
        double per = -1.0 / (diagonal[c] * M[6 * c + c]);
        for (int j = 0; j < n; j++) {
            double sum = 0.0;
            for (int m = c; m < n; m++) sum += Q[n * j + m] * M[6 * m + c];
            sum *= per;
            for (int m = c; m < n; m++) Q[n * j + m] -= sum * M[6 * m + c];
        }
    }
    for (int j = 0; j < n; j++) {
        for (int i = 5; i >= 0; i--) { /* P = diag(scale) Q₁ R⁻ᵀ, row by row */
            double x = Q[n * j + i];
            for (int m = i + 1; m < 6; m++) x -= M[6 * i + m] * P[6 * j + m];
            P[6 * j + i] = x / diagonal[i];
        }
        for (int i = 0; i < 6; i++) {
            P[6 * j + i] *= scale[j];
            largest = fmax(largest, fabs(P[6 * j + i]));
            if (!isfinite(P[6 * j + i])) return 0;
        }
        for (int m = 6; m < n; m++) N[(n - 6) * j + m - 6] = scale[j] * Q[n * j + m];
    }
    return largest < LARGE_INVERSE;
}

/* The joints outside their limits, and the velocities that lead them back: as VelocityBox.update, after box(). */
static int lead_back(Kernel *k) {
    const double h = D(k, B_SCALARS)[DT];
    int count = 0;
    for (int j = 0; j < k->joints; j++) {
        double x = D(k, B_POSITIONS)[j], up = D(k, B_HIGH)[j] - x, down = x - D(k, B_LOW)[j];
        double share = RECOVERY_SHARE * (isfinite(D(k, B_MAXSPEED)[j]) ? D(k, B_MAXSPEED)[j] : 1.0);
        if (!(isfinite(x) && isfinite(D(k, B_VPREV)[j]))) return -1;
        D(k, B_RECOVERY)[j] = 0.0;
        if (up >= 0.0 && down >= 0.0) continue;
        double way = clamp((up < 0.0 ? up - INSIDE : INSIDE - down) / h, -share, share);
        D(k, B_RECOVERY)[j] = clamp(way, D(k, B_LOWER)[j], D(k, B_UPPER)[j]);
        L(k, B_OUTSIDE)[count++] = j;
    }
    return count;
}

/* v = base + columns x of one arm with the joints from start on; z is the first of its null-space unknowns. */
static void fill_columns(Kernel *k, int start, int n, int z, const double *P, const double *N,
                         double T[10][6], double cap) {
    const double *unit = D(k, B_UNIT), *wish = D(k, B_NULL_ALONG) + start, *offset = D(k, B_NULL_OFFSET) + start;
    const double *scale = D(k, B_SCALE) + start;
    const int width = k->unknowns, extra = n - 6;
    double along[MAX_JOINTS], rest[MAX_JOINTS]; /* the wishes' coordinates in the null-space */
    for (int e = 0; e < extra; e++) {
        along[e] = rest[e] = 0.0;
        for (int j = 0; j < n; j++) {
            double per = N[extra * j + e] / (scale[j] * scale[j]);
            along[e] += per * wish[j];
            rest[e] += per * offset[j];
        }
    }
    for (int j = 0; j < n; j++) {
        double x[10], *row = D(k, B_COLUMNS) + width * (start + j);
        for (int c = 0; c < 10; c++) {
            x[c] = 0.0;
            for (int i = 0; i < 6; i++) x[c] += P[6 * j + i] * T[c][i];
        }
        for (int e = 0; e < extra; e++) {
            x[6] += N[extra * j + e] * along[e];
            x[9] += N[extra * j + e] * rest[e];
        }
        for (int c = 0; c < 6; c++) row[c] = x[c] * unit[c];
        for (int c = 6; c < 9; c++) row[c] = -x[c] * unit[c];
        for (int e = 0; e < extra; e++) row[z + e] = N[extra * j + e] * unit[z + e];
        D(k, B_BASE)[start + j] = x[9] + x[7] + x[8] + cap * x[6];
    }
}

/* The condensed QP of this step: base, columns, and the rows of unit norm with their bounds. Returns the number of
 * joints outside their limits, −1 where an arm is near a singularity or something is not finite. */
static int condensed_rows(Kernel *k, double cap, double clock, double span) {
    const double *R = D(k, B_R), *p = D(k, B_P);
    double T[10][6]; /* world twists: the object's six directions, ν, c_k, c_p, b_k */
    int z = TWIST_AND_SHARES, width = k->unknowns;
    if (D(k, B_SCALARS)[ON_LINE] != 0.0) follow_line(k, clock, span);
    if (!errors(k)) return -1;
    corrections(k);
    box(k);
    int outside = lead_back(k);
    if (outside < 0) return -1;
    for (int c = 0; c < 6; c++) {
        double one[6] = {0};
        one[c] = 1.0;
        to_world(R, p, one, T[c]);
    }
    to_world(R, p, D(k, B_ALONG), T[6]);
    to_world(R, p, D(k, B_PATH), T[8]);
    for (int a = 0; a < k->arms; a++) {
        int n = (int)L(k, B_SIZES)[a], start = (int)L(k, B_STARTS)[a];
        double P[6 * MAX_JOINTS], N[MAX_JOINTS * MAX_JOINTS];
        to_world(R, p, D(k, B_GRASP) + 6 * a, T[7]);
        to_world(R, p, D(k, B_OFFSETS) + 6 * a, T[9]);
        if (!right_inverse(D(k, B_JACOBIAN) + 6 * start, D(k, B_SCALE) + start, n, P, N)) return -1;
        fill_columns(k, start, n, z, P, N, T, cap);
        z += n - 6;
    }
    for (int j = 0; j < k->joints; j++) {
        const double *column = D(k, B_COLUMNS) + width * j;
        double square = 0.0, base = D(k, B_BASE)[j];
        for (int c = 0; c < width; c++) square += column[c] * column[c];
        double norm = square < 1e-24 ? 1.0 : sqrt(square), per = 1.0 / norm;
        if (!isfinite(norm) || !isfinite(base)) return -1;
        for (int c = 0; c < width; c++) D(k, B_ROWS)[width * j + c] = column[c] * per;
        D(k, B_NORMS)[j] = norm;
        D(k, B_ROW_LOWER)[j] = (D(k, B_LOWER)[j] - base) * per;
        D(k, B_ROW_UPPER)[j] = (D(k, B_UPPER)[j] - base) * per;
    }
    return outside;
}

/* -- a border of the preview, see border.py --------------------------------------------------------------------------- */

/* Larger, or not a number. */
static int beyond(double x, double largest) { return x > largest || x != x; }

static void border_evaluate(Border *b, double span) {
    const double *slope = D(b, SLOPE), *before = D(b, BEFORE), *x = D(b, POSITIONS), per_span = 1.0 / span;
    const double *low = D(b, LOW), *high = D(b, HIGH), *acceleration = D(b, ACCELERATION);
    const double *per_speed = D(b, PER_SPEED), *per_bend = D(b, PER_BEND), *slope_change = D(b, SLOPE_CHANGE);
    double *curvature = D(b, CURVATURE), *result = D(b, RESULT);
    double fastest = 0.0, change = -INFINITY, by_speed = 0.0, by_bend = 0.0, tightest = 0.0;
    int j_speed = 0, j_bend = 0, inside = 1;
    for (int j = 0; j < b->joints; j++) {
        double now = fabs(slope[j]), then = fabs(before[j]), speed = beyond(then, now) ? then : now;
        double step = slope[j] - before[j];
        curvature[j] = step * per_span;
        double use_speed = speed * per_speed[j], use_bend = fabs(curvature[j]) * per_bend[j];
        if (beyond(now, fastest)) fastest = now;
        if (beyond(fabs(step) - slope_change[j], change)) change = fabs(step) - slope_change[j];
        if (beyond(use_speed, by_speed)) by_speed = use_speed, j_speed = j;
        if (beyond(use_bend, by_bend)) by_bend = use_bend, j_bend = j;
        inside &= (x[j] <= high[j]) & (x[j] >= low[j]);
    }
    double most = b->caps_speed ? by_speed * by_speed : 0.0;
    most = by_bend > most ? by_bend : most;
    double cap = 1.0 / (most > 1.0 ? most : 1.0);
    for (int j = 0; j < b->joints; j++) {
        double now = fabs(slope[j]), then = fabs(before[j]), speed = then > now ? then : now;
        double time = speed / (acceleration[j] - fabs(curvature[j]) * cap);
        if (beyond(time, tightest)) tightest = time;
    }
    double values[9] = {fastest, change, by_speed, j_speed, by_bend, j_bend, cap, tightest, inside};
    memcpy(result, values, sizeof values);
}

const Arithmetic ARITHMETIC = {fused_step, observe, condensed_rows, border_evaluate};
