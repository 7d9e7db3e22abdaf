/* Kinematics of one arm at one configuration: its tool's pose and Jacobian, Newton's method, derivatives along a way.
 *
 * An arm is 14 numbers per joint and 12 for its tool: rotation (9, row major) and origin (3) of the joint in the frame of
 * the one before, both with the z axis along the joint's axis; 1 if it slides; its weight. The tool is R (9), p (3) in
 * the last joint. Poses are R (9), p (3) in the world, Jacobians are transposed (joints, 6): [linear; angular] of the
 * tool's point in world axes. batch_plain.py says the same in NumPy. */

#ifndef COOPQP_ARM_H
#define COOPQP_ARM_H

#include <string.h>

#include "spatial.h"

#define PER_JOINT 14
#define MOST_JOINTS 64
#define SLIDES 12
#define WEIGHT 13
#define LEAST_DAMPING 1e-15
#ifdef __GNUC__
#define UNROLL _Pragma("GCC unroll 6")
#else
#define UNROLL
#endif

struct Arm {
    int joints;
    const double *numbers, *tool;
};

/* -- one configuration ----------------------------------------------------------------------------------------------- */

static void place(const Arm *a, const double *q, double *T, double *jacobian) {
    double R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, p[3] = {0, 0, 0}, origins[3 * MOST_JOINTS];
    for (int j = 0; j < a->joints; j++) {
        const double *joint = a->numbers + PER_JOINT * j;
        double M[9];
        for (int i = 0; i < 3; i++) p[i] += dot3(R + 3 * i, joint + 9);
        multiply3(R, joint, M);
        if (joint[SLIDES] != 0.0) {
            for (int i = 0; i < 3; i++) p[i] += q[j] * M[3 * i + 2];
            memcpy(R, M, sizeof M);
        } else {
            const double s = sin(q[j]), c = cos(q[j]);
            for (int i = 0; i < 3; i++) {
                R[3 * i] = c * M[3 * i] + s * M[3 * i + 1];
                R[3 * i + 1] = c * M[3 * i + 1] - s * M[3 * i];
                R[3 * i + 2] = M[3 * i + 2];
            }
        }
        if (jacobian)
            for (int i = 0; i < 3; i++) jacobian[6 * j + 3 + i] = R[3 * i + 2], origins[3 * j + i] = p[i];
    }
    multiply3(R, a->tool, T);
    for (int i = 0; i < 3; i++) T[9 + i] = p[i] + dot3(R + 3 * i, a->tool + 9);
    for (int j = 0; jacobian && j < a->joints; j++) {
        double *row = jacobian + 6 * j;
        if (a->numbers[PER_JOINT * j + SLIDES] != 0.0) {
            memcpy(row, row + 3, 3 * sizeof(double));
            memset(row + 3, 0, 3 * sizeof(double));
        } else {
            const double arm[3] = {T[9] - origins[3 * j], T[10] - origins[3 * j + 1], T[11] - origins[3 * j + 2]};
            cross(row + 3, arm, row);
        }
    }
}

/* What leads from T to the target: displacement and rotation vector in world axes. Returns the largest entry. */
static double error_of(const double *T, const double *target, double *e) {
    double D[9], largest = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) D[3 * i + j] = dot3(target + 3 * i, T + 3 * j);
    rotation_vector(D, e + 3);
    for (int i = 0; i < 3; i++) e[i] = target[9 + i] - T[9 + i];
    for (int i = 0; i < 6; i++) largest = maximum(largest, fabs(e[i]));
    return isfinite(e[0] + e[1] + e[2] + e[3] + e[4] + e[5]) ? largest : INFINITY;
}

/* W², by which joint j's motion counts. */
static double weight_of(const Arm *a, int j) {
    const double weight = a->numbers[PER_JOINT * j + WEIGHT];
    return weight * weight;
}

static double dot6(const double *a, const double *b) { return dot3(a, b) + dot3(a + 3, b + 3); }

/* Factors L D L' of J W² J' + damping I: L' above the diagonal, D⁻¹ on it; 0 if it is not positive definite. */
static int factor(const Arm *a, const double *jacobian, double damping, double *G) {
    double trace = 0.0;
    memset(G, 0, 36 * sizeof(double));
    for (int j = 0; j < a->joints; j++) {
        const double *row = jacobian + 6 * j, weight = weight_of(a, j);
        UNROLL for (int i = 0; i < 6; i++) {
            const double x = weight * row[i];
            UNROLL for (int m = i; m < 6; m++) G[6 * i + m] += x * row[m];
        }
    }
    UNROLL for (int i = 0; i < 6; i++) trace += G[7 * i];
    UNROLL for (int i = 0; i < 6; i++) G[7 * i] += damping + LEAST_DAMPING * trace;
    UNROLL for (int k = 0; k < 6; k++) {
        if (!(G[7 * k] > 0.0)) return 0;
        G[7 * k] = 1.0 / G[7 * k]; /* no square root: each step waits for the one before */
        UNROLL for (int i = k + 1; i < 6; i++) {
            const double below = G[6 * k + i] * G[7 * k];
            UNROLL for (int m = i; m < 6; m++) G[6 * i + m] -= below * G[6 * k + m];
            G[6 * k + i] = below;
        }
    }
    return 1;
}

/* y with the factored matrix times y = e. */
static void solve_factored(const double *G, const double *e, double *y) {
    UNROLL for (int k = 0; k < 6; k++) {
        y[k] = e[k];
        UNROLL for (int i = 0; i < k; i++) y[k] -= G[6 * i + k] * y[i];
    }
    UNROLL for (int i = 5; i >= 0; i--) {
        y[i] *= G[7 * i];
        UNROLL for (int k = i + 1; k < 6; k++) y[i] -= G[6 * i + k] * y[k];
    }
}

/* v = W² J' (J W² J' + damping I)⁻¹ e; returns the largest step, infinite on failure. */
static double newton_step(const Arm *a, const double *jacobian, const double *e, double damping, double *v) {
    double G[36], y[6], largest = 0.0;
    if (!factor(a, jacobian, damping, G)) return INFINITY;
    solve_factored(G, e, y);
    for (int j = 0; j < a->joints; j++) {
        v[j] = weight_of(a, j) * dot6(jacobian + 6 * j, y);
        largest = maximum(largest, fabs(v[j]));
    }
    return isfinite(largest) ? largest : INFINITY;
}

/* Newton's method from q; returns the residual. */
static double solve(const Arm *a, const double *target, double *q, double tolerance, int steps, double longest,
                    double damping) {
    double T[12], jacobian[6 * MOST_JOINTS], e[6], v[MOST_JOINTS];
    for (int i = 0;; i++) {
        place(a, q, T, jacobian);
        const double residual = error_of(T, target, e);
        if (residual <= tolerance || i >= steps || residual == INFINITY) return residual;
        double square = 0.0;
        for (int k = 0; k < 6; k++) square += e[k] * e[k];
        const double largest = newton_step(a, jacobian, e, damping * square, v);
        if (largest == INFINITY) return residual;
        const double share = largest > longest ? longest / largest : 1.0;
        for (int j = 0; j < a->joints; j++) q[j] += share * v[j];
    }
}

/* -- along a way ----------------------------------------------------------------------------------------------------- */

/* Triangular factors of A (6, 6) in place, with the rows in an order of largest pivots; whether det A is negative. */
static int eliminate(double *A, int *order) {
    int negative = 0;
    for (int k = 0; k < 6; k++) order[k] = k;
    for (int k = 0; k < 6; k++) {
        int pivot = k;
        for (int i = k + 1; i < 6; i++)
            if (fabs(A[6 * i + k]) > fabs(A[6 * pivot + k])) pivot = i;
        for (int j = 0; pivot != k && j < 6; j++) {
            const double other = A[6 * pivot + j];
            A[6 * pivot + j] = A[6 * k + j], A[6 * k + j] = other;
        }
        const int row = order[pivot];
        order[pivot] = order[k], order[k] = row;
        negative ^= (pivot != k) ^ (A[7 * k] < 0.0);
        for (int i = k + 1; i < 6; i++) {
            const double f = A[6 * i + k] /= A[7 * k];
            for (int j = k + 1; j < 6; j++) A[6 * i + j] -= f * A[6 * k + j];
        }
    }
    return negative;
}

/* x with J x = V from the factors of Jᵀ. */
static void solve_eliminated(const double *A, const int *order, const double *V, double *x) {
    double y[6];
    for (int k = 0; k < 6; k++) {
        y[k] = V[k];
        for (int i = 0; i < k; i++) y[k] -= A[6 * i + k] * y[i];
        y[k] /= A[7 * k];
    }
    for (int k = 5; k >= 0; k--) {
        for (int i = k + 1; i < 6; i++) y[k] -= A[6 * i + k] * y[i];
        x[order[k]] = y[k];
    }
}

/* J′ = Σ_i q′_i ∂_i J, transposed (joints, 6): Lie brackets of the columns, their sums over i as running sums. */
static void jacobian_slopes(const Arm *a, const double *jacobian, const double *slope, double *out) {
    double turned[3] = {0, 0, 0}, beyond[3] = {0, 0, 0}, by_beyond[3];
    for (int j = 0; j < a->joints; j++) { /* by the joints up to j */
        const double *row = jacobian + 6 * j;
        for (int i = 0; i < 3; i++) turned[i] += slope[j] * row[3 + i];
        cross(turned, row, out + 6 * j);
        cross(turned, row + 3, out + 6 * j + 3);
    }
    for (int j = a->joints - 1; j >= 0; j--) { /* by the joints after j */
        const double *row = jacobian + 6 * j;
        cross(row + 3, beyond, by_beyond);
        for (int i = 0; i < 3; i++) out[6 * j + i] += by_beyond[i], beyond[i] += slope[j] * row[i];
    }
}

/* q′ and q″ of an arm of six joints or more, for the tool's twist V and its slope: see batch_plain.py. */
static void derivatives(const Arm *a, const double *q, const double *V, const double *dV, double *slope, double *curvature) {
    double T[12], jacobian[6 * MOST_JOINTS], slopes[6 * MOST_JOINTS], G[36], rest[6], y[6], dy[6], turn[MOST_JOINTS];
    int order[6];
    place(a, q, T, jacobian);
    memcpy(rest, dV, sizeof rest);
    if (a->joints == 6) {
        memcpy(G, jacobian, sizeof G);
        eliminate(G, order);
        solve_eliminated(G, order, V, slope);
        jacobian_slopes(a, jacobian, slope, slopes);
        for (int j = 0; j < 6; j++)
            for (int i = 0; i < 6; i++) rest[i] -= slope[j] * slopes[6 * j + i];
        solve_eliminated(G, order, rest, curvature);
        return;
    }
    if (!factor(a, jacobian, 0.0, G)) {
        for (int j = 0; j < a->joints; j++) slope[j] = curvature[j] = NAN;
        return;
    }
    solve_factored(G, V, y);
    for (int j = 0; j < a->joints; j++) slope[j] = weight_of(a, j) * dot6(jacobian + 6 * j, y);
    jacobian_slopes(a, jacobian, slope, slopes);
    for (int j = 0; j < a->joints; j++) {
        turn[j] = weight_of(a, j) * dot6(slopes + 6 * j, y);
        for (int i = 0; i < 6; i++) rest[i] -= slope[j] * slopes[6 * j + i] + turn[j] * jacobian[6 * j + i];
    }
    solve_factored(G, rest, dy);
    for (int j = 0; j < a->joints; j++) curvature[j] = turn[j] + weight_of(a, j) * dot6(jacobian + 6 * j, dy);
}

/* -- along poses ----------------------------------------------------------------------------------------------------- */

/* Whether det J of an arm of six joints is negative; 0 for other arms. */
static int orientation(const Arm *a, const double *q) {
    double T[12], A[6 * MOST_JOINTS];
    int order[6];
    if (a->joints != 6) return 0;
    place(a, q, T, A);
    return eliminate(A, order);
}

/* Halfway between two poses: along the line, about one axis. */
static void halfway(const double *from, const double *to, double *between) {
    double D[9], w[3], R[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) D[3 * i + j] = dot3(to + 3 * i, from + 3 * j);
    rotation_vector(D, w);
    for (int i = 0; i < 3; i++) w[i] *= 0.5;
    exp3(w, R);
    multiply3(R, from, between);
    for (int i = 0; i < 3; i++) between[9 + i] = 0.5 * (from[9 + i] + to[9 + i]);
}

/* From q at one pose to the next without a jump and without passing a singularity; halves the way where it has to. */
static int step_to(const Arm *a, const double *from, const double *to, double *q, double tolerance, double longest,
                   int halvings) {
    double next[MOST_JOINTS], between[12], furthest = 0.0;
    memcpy(next, q, sizeof(double) * (size_t)a->joints);
    const double residual = solve(a, to, next, tolerance, 12, longest, 0.0);
    for (int j = 0; j < a->joints; j++) furthest = maximum(furthest, fabs(next[j] - q[j]));
    if (residual <= tolerance && furthest <= longest && orientation(a, next) == orientation(a, q)) {
        memcpy(q, next, sizeof(double) * (size_t)a->joints);
        return 1;
    }
    if (halvings <= 0) return 0;
    halfway(from, to, between);
    return step_to(a, from, between, q, tolerance, longest, halvings - 1) &&
           step_to(a, between, to, q, tolerance, longest, halvings - 1);
}

#endif
