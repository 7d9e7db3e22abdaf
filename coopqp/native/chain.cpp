/* The closed chain: errors, corrections, and joint velocities from twists of the object. */

#include "functions.h"

/* -- errors and corrections ------------------------------------------------------------------------------------------ */

static int errors_at(const Core *c, const double *carried, const double *R, const double *p, double *errors) {
    for (int k = 0; k < c->arms; k++) {
        const double *O = carried + 12 * k;
        double E[9], away[3] = {O[9] - p[0], O[10] - p[1], O[11] - p[2]}, e[3];
        multiply3_back(R, O, E);
        rotate_back(R, away, e);
        if (!log6(E, e, errors + 6 * k)) return 0;
    }
    return 1;
}

static void common_error(const Core *c, const double *errors, double *common) {
    memset(common, 0, 6 * sizeof(double));
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) common[i] += c->shares[6 * k + i] * errors[6 * k + i];
}

/* Shrink n corrections by one common factor to the bounds of speed and spin. */
static double bound(const Core *c, double *twists, int n) {
    double linear = 0.0, angular = 0.0;
    for (int k = 0; k < n; k++) {
        linear = fmax(linear, dot3(twists + 6 * k, twists + 6 * k));
        angular = fmax(angular, dot3(twists + 6 * k + 3, twists + 6 * k + 3));
    }
    const double excess =
        fmax(sqrt(linear) / c->options->correction_speed, sqrt(angular) / c->options->correction_spin);
    for (int i = 0; excess > 1.0 && i < 6 * n; i++) twists[i] /= excess;
    return maximum(excess, 1.0);
}

/* What the grasps were asked to shift since the step before, of which the errors foreseen did not know; or nullptr. */
static const double *asked_to_shift(const Core *c) {
    return c->loop->has_predicted != 0.0 && c->loop->shift_asked != 0.0 ? (double *)c->asked_shift : nullptr;
}

/* c_k, c_p, and b_k: the error of the last linearisation; beyond what that step foresaw it is left over. Gains take away
 * no more than the whole error in a step. What was asked of the grasps is no error: it is made up for in this step. */
static void corrections(Core *c, double h) {
    const double grasp_gain = fmin(c->options->grasp_gain, 1.0 / h), path_gain = fmin(c->options->path_gain, 1.0 / h);
    const double *seen = c->proposal->has_measured != 0.0 ? c->measured : c->common;
    const double *asked = asked_to_shift(c);
    const int predicted = c->loop->has_predicted != 0.0;
    double common_shift[6];
    common_error(c, c->errors, c->common);
    if (asked) common_error(c, asked, common_shift);
    for (int k = 0; k < c->arms; k++)
        for (int i = 0; i < 6; i++) {
            double e = c->errors[6 * k + i];
            c->grasp[6 * k + i] = -grasp_gain * (e - c->common[i]);
            if (asked) {
                e += asked[6 * k + i];
                c->grasp[6 * k + i] -= grasp_gain * (asked[6 * k + i] - common_shift[i]);
            }
            const double shift = asked ? asked[6 * k + i] / h : 0.0;
            c->foresees[6 * k + i] = predicted ? (c->predicted[6 * k + i] - e) / c->loop->last_dt : 0.0;
            c->offsets[6 * k + i] = c->foresees[6 * k + i] + shift;
            c->left_over[6 * k + i] = predicted ? c->offsets[6 * k + i] - c->foreseen[6 * k + i] : 0.0;
        }
    for (int i = 0; i < 6; i++) c->path[i] = -path_gain * seen[i];
    c->proposal->closes = h * grasp_gain / bound(c, c->grasp, c->arms);
    bound(c, c->path, 1);
}

/* -- linear algebra: one small system, two right-hand sides ---------------------------------------------------------- */

/* Two numbers side by side, as GCC and Clang know them; other compilers leave it to the plain step. */
typedef double pair __attribute__((vector_size(16)));
/* Rows of [A | b₀ b₁]: entry (i, j) is rows[i][j / 2][j % 2]. */
typedef pair Rows[6][4];
#define UNROLL _Pragma("GCC unroll 6")

/* Solve by elimination with partial pivoting; the answers take the right-hand sides' place. Returns the smallest pivot, 0 if
 * the matrix is singular. */
static double solve6(Rows A) {
    double scale = 0.0, least = INFINITY, inverse[6];
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
        if (!(largest > SMALLEST_PIVOT * scale)) return 0.0;
        least = largest < least ? largest : least;
        if (pivot != k)
            for (int j = first; j < 4; j++) {
                pair other = A[pivot][j];
                A[pivot][j] = A[k][j];
                A[k][j] = other;
            }
        inverse[k] = 1.0 / A[k][first][k % 2];
        UNROLL for (int i = k + 1; i < 6; i++) {
            double f = A[i][first][k % 2] * inverse[k];
            for (int j = first; j < 4; j++) A[i][j] -= pair{f, f} * A[k][j];
        }
    }
    UNROLL for (int k = 5; k >= 0; k--) {
        pair x = A[k][3];
        UNROLL for (int j = k + 1; j < 6; j++) {
            double f = A[k][j / 2][j % 2];
            x -= pair{f, f} * A[j][3];
        }
        A[k][3] = x * pair{inverse[k], inverse[k]};
    }
    return least;
}

/* Of one arm with n ≥ 6 joints: velocities v0, v1 for the world twists w0, w1, near the null-space wishes u0, u1 of a
 * redundant arm: v = u + A⁺(w − J u), A⁺ the right inverse of least Σ (v/scale)². Returns the smallest pivot of A, or, of a
 * redundant arm, the root of the smallest pivot of A Aᵀ; 0 if it is singular. */
static double arm_velocities(const double *JT, const double *scale, int n, const double *w0, const double *w1,
                             const double *u0, const double *u1, double *v0, double *v1) {
    Rows A;
    double least;
    if (n == 6) {
        for (int i = 0; i < 6; i++) {
            for (int j = 0; j < 3; j++) A[i][j] = pair{JT[12 * j + i], JT[12 * j + 6 + i]};
            A[i][3] = pair{w0[i], w1[i]};
        }
        if (!((least = solve6(A)) > 0.0)) return 0.0;
        for (int j = 0; j < 6; j++) v0[j] = A[j][3][0], v1[j] = A[j][3][1];
        return least;
    }
    for (int i = 0; i < 6; i++) {
        double first = w0[i], second = w1[i];
        for (int k = 0; k <= i; k++) {
            double sum = 0.0;
            for (int j = 0; j < n; j++) sum += JT[6 * j + i] * JT[6 * j + k] * scale[j] * scale[j];
            A[i][k / 2][k % 2] = A[k][i / 2][i % 2] = sum;
        }
        for (int j = 0; j < n; j++) first -= JT[6 * j + i] * u0[j], second -= JT[6 * j + i] * u1[j];
        A[i][3] = pair{first, second};
    }
    if (!((least = solve6(A)) > 0.0)) return 0.0;
    for (int j = 0; j < n; j++) {
        double first = 0.0, second = 0.0;
        for (int i = 0; i < 6; i++) first += JT[6 * j + i] * A[i][3][0], second += JT[6 * j + i] * A[i][3][1];
        v0[j] = u0[j] + scale[j] * scale[j] * first;
        v1[j] = u1[j] + scale[j] * scale[j] * second;
    }
    return sqrt(least);
}

static void cross3(const double *a, const double *b, double *out) {
    for (int i = 0; i < 3; i++) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/* From the Jacobian's point to the point nearest to the axes of the arm's turning joints: (Σ 1 − a aᵀ) way = Σ a × v.
 * Returns whether it is far. */
static int far_from_axes(const double *JT, int n, double *way) {
    double S[3][3] = {{0}}, C[3][3], feet[3] = {0}, foot[3];
    for (int j = 0; j < n; j++) {
        const double *v = JT + 6 * j, *a = v + 3;
        if (dot3(a, a) < 0.5) continue; /* it slides */
        cross3(a, v, foot);
        for (int i = 0; i < 3; i++) {
            feet[i] += foot[i];
            for (int m = 0; m < 3; m++) S[i][m] += (i == m) - a[i] * a[m];
        }
    }
    for (int i = 0; i < 3; i++) cross3(S[(i + 1) % 3], S[(i + 2) % 3], C[i]); /* rows of the adjugate, S is symmetric */
    const double det = dot3(S[0], C[0]);
    if (!(det > 1e-9)) return 0;
    for (int i = 0; i < 3; i++) way[i] = dot3(C[i], feet) / det;
    return dot3(way, way) > LONG_LEVER * LONG_LEVER;
}

/* A twist at another point. */
static void twist_at(const double *w, const double *way, double *out) {
    cross3(w + 3, way, out);
    for (int i = 0; i < 3; i++) out[i] += w[i], out[3 + i] = w[3 + i];
}

/* The same where the Jacobian's point is far from the arm: about a point of the arm, so that its lever does not count as
 * a singularity. 0 where it is near. */
static double far_velocities(const double *JT, const double *scale, int n, const double *w0, const double *w1,
                             const double *u0, const double *u1, double *v0, double *v1) {
    double way[3], near[6 * MOST_JOINTS], first[6], second[6];
    if (!far_from_axes(JT, n, way)) return 0.0;
    for (int j = 0; j < n; j++) twist_at(JT + 6 * j, way, near + 6 * j);
    twist_at(w0, way, first);
    twist_at(w1, way, second);
    return arm_velocities(near, scale, n, first, second, u0, u1, v0, v1);
}

/* The same for all arms: w0 (6 arms) has a twist per arm, w1 (6) is common to all; u0 and u1 (joints) may be nullptr. The
 * smallest pivots are kept. */
static int two_velocities(const Core *c, const double *jacobian, const double *w0, const double *w1, const double *u0,
                          const double *u1, double *v0, double *v1) {
    static const double still[MOST_JOINTS] = {};
    for (int k = 0; k < c->arms; k++) {
        const int n = (int)c->arm_size[k], j = (int)c->arm_start[k];
        const double *JT = jacobian + 6 * j, *scale = c->scale + j, *own = w0 + 6 * k;
        const double *wish0 = u0 ? u0 + j : still, *wish1 = u1 ? u1 + j : still;
        double least = arm_velocities(JT, scale, n, own, w1, wish0, wish1, v0 + j, v1 + j);
        if (!(least > 0.0)) least = far_velocities(JT, scale, n, own, w1, wish0, wish1, v0 + j, v1 + j);
        if (!(least > 0.0)) return 0;
        c->least_pivot[k] = least;
    }
    return 1;
}

/* A twist of the reference object frame in world axes. */
static void to_world(const double *R, const double *twist, double *out) {
    rotate(R, twist, out);
    rotate(R, twist + 3, out + 3);
}

/* v = u + A⁺(σ ν + c_p + c_k + b_k − J u): the command at full corrections and rate `cap`, and what a unit of rate adds. */
static int nominal_command(Core *c, double cap) {
    double *w = c->scratch, along[6], common[6];
    const double *u0 = nullptr, *u1 = nullptr;
    for (int i = 0; i < 6; i++) common[i] = cap * c->along[i] + c->path[i];
    for (int k = 0; k < c->arms; k++) {
        double twist[6];
        for (int i = 0; i < 6; i++) twist[i] = common[i] + c->grasp[6 * k + i] + c->offsets[6 * k + i];
        to_world(c->R, twist, w + 6 * k);
    }
    to_world(c->R, c->along, along);
    if (c->redundant) {
        double *wish = w + 6 * c->arms;
        for (int j = 0; j < c->joints; j++) wish[j] = cap * c->null_along[j] + c->null_offset[j];
        u0 = wish, u1 = c->null_along;
    }
    return two_velocities(c, c->jacobian, w, along, u0, u1, c->command, c->along_velocity);
}

/* -- wishes of redundant arms ---------------------------------------------------------------------------------------- */

/* √det(J Jᵀ) of one arm */
static double manipulability(const Core *c, int k, const double *positions, double *jacobian) {
    static const double about[3] = {};
    const int n = (int)c->arm_size[k];
    follow_arm(c, k, positions, about, nullptr, jacobian);
    const double *JT = jacobian + 6 * (int)c->arm_start[k];
    double G[36], det = 1.0;
    for (int i = 0; i < 6; i++)
        for (int m = 0; m < 6; m++) {
            G[6 * i + m] = 0.0;
            for (int j = 0; j < n; j++) G[6 * i + m] += JT[6 * j + i] * JT[6 * j + m];
        }
    for (int i = 0; i < 6; i++) { /* Gᴸᵀ: no pivots, for it is positive semidefinite */
        det *= G[7 * i];
        if (!(G[7 * i] > 0.0)) return 0.0;
        for (int m = i + 1; m < 6; m++) {
            double f = G[6 * m + i] / G[7 * i];
            for (int j = i; j < 6; j++) G[6 * m + j] -= f * G[6 * i + j];
        }
    }
    return sqrt(det);
}

static double wrapped(const Core *c, int j, double angle) {
    return c->continuous[j] != 0.0 ? remainder(angle, 2.0 * 3.14159265358979323846) : angle;
}

static void posture_velocity(Core *c, const double *positions, double *v) {
    const Options *o = c->options;
    const double step = 1e-5;
    double excess = 1.0;
    for (int k = 0; k < c->arms; k++) {
        const int start = (int)c->arm_start[k], end = start + (int)c->arm_size[k];
        for (int j = start; j < end; j++) {
            v[j] = 0.0;
            if (end - start <= 6) continue;
            v[j] = o->posture_gain * wrapped(c, j, c->posture_target[j] - positions[j]);
            if (c->posture_bounded[j] != 0.0) v[j] += o->centring * (c->posture_middle[j] - positions[j]);
            if (o->manipulability > 0.0) {
                double *moved = c->posture_work, *jacobian = moved + c->joints;
                memcpy(moved, positions, sizeof(double) * (size_t)c->joints);
                moved[j] += step;
                double up = manipulability(c, k, moved, jacobian);
                moved[j] = positions[j] - step;
                v[j] += o->manipulability * (up - manipulability(c, k, moved, jacobian)) / (2.0 * step);
            }
            excess = fmax(excess, fabs(v[j]) / c->posture_cap[j]);
        }
    }
    for (int j = 0; excess > 1.0 && j < c->joints; j++) v[j] /= excess;
}
