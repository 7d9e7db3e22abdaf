/* Vectors, rotations (row major) and the logarithm and exponential of placements. */

#ifndef COOPQP_SPATIAL_H
#define COOPQP_SPATIAL_H

#include <math.h>

static inline void cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* One instruction each, where fmax and fmin are calls. A `y` that is no number counts for nothing. */
static inline double maximum(double x, double y) { return y > x ? y : x; }
static inline double minimum(double x, double y) { return y < x ? y : x; }

static inline double clamp(double x, double low, double high) { return x < low ? low : (x > high ? high : x); }

/* out = R x */
static inline void rotate(const double *R, const double *x, double *out) {
    for (int i = 0; i < 3; i++) out[i] = dot3(R + 3 * i, x);
}

/* out = Rᵀ x */
static inline void rotate_back(const double *R, const double *x, double *out) {
    for (int i = 0; i < 3; i++) out[i] = R[i] * x[0] + R[3 + i] * x[1] + R[6 + i] * x[2];
}

/* C = A B */
static inline void multiply3(const double *A, const double *B, double *C) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
}

/* C = Aᵀ B */
static inline void multiply3_back(const double *A, const double *B, double *C) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) C[3 * i + j] = A[i] * B[j] + A[3 + i] * B[3 + j] + A[6 + i] * B[6 + j];
}

/* Rotation of a rotation vector (Rodrigues). */
static inline void exp3(const double *w, double *R) {
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

/* Rotation vector of R, any angle up to half a turn: from the largest entry of its quaternion. */
static inline void rotation_vector(const double *R, double *w) {
    double x[4] = {1.0 + R[0] + R[4] + R[8], 1.0 + R[0] - R[4] - R[8], 1.0 - R[0] + R[4] - R[8], 1.0 - R[0] - R[4] + R[8]};
    int k = 0;
    for (int i = 1; i < 4; i++)
        if (x[i] > x[k]) k = i;
    const double a = R[7] - R[5], b = R[2] - R[6], c = R[3] - R[1];
    const double d = R[3] + R[1], e = R[2] + R[6], f = R[7] + R[5];
    double v[4];
    if (k == 0) v[0] = x[0], v[1] = a, v[2] = b, v[3] = c;
    else if (k == 1) v[0] = a, v[1] = x[1], v[2] = d, v[3] = e;
    else if (k == 2) v[0] = b, v[1] = d, v[2] = x[2], v[3] = f;
    else v[0] = c, v[1] = e, v[2] = f, v[3] = x[3];
    const double norm = sqrt(dot3(v + 1, v + 1)), sign = v[0] < 0.0 ? -1.0 : 1.0;
    const double ratio = norm > 0.0 ? 2.0 * atan2(norm, sign * v[0]) / norm : 0.0;
    for (int i = 0; i < 3; i++) w[i] = sign * ratio * v[1 + i];
}

/* V⁻¹(ω) p = p − ½ ω×p + (1 − θ/2 cot(θ/2)) / θ² ω×(ω×p) */
static inline void unroll(const double *omega, double third, const double *p, double *out) {
    double wp[3], wwp[3];
    cross(omega, p, wp);
    cross(omega, wp, wwp);
    for (int i = 0; i < 3; i++) out[i] = p[i] - 0.5 * wp[i] + third * wwp[i];
}

/* Twist of a placement; 0 near half a turn, or for numbers that are not finite. */
static inline int log6(const double *R, const double *p, double *e) {
    double w[3] = {0.5 * (R[7] - R[5]), 0.5 * (R[2] - R[6]), 0.5 * (R[3] - R[1])};
    double s2 = dot3(w, w), c = 0.5 * (R[0] + R[4] + R[8] - 1.0);
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
    for (int i = 0; i < 3; i++) e[3 + i] = ratio * w[i];
    unroll(e + 3, third, p, e);
    return isfinite(e[0]) && isfinite(e[1]) && isfinite(e[2]);
}

/* exp of a twist */
static inline void exp6(const double *twist, double *R, double *p) {
    const double *w = twist + 3, t2 = dot3(w, w), t = sqrt(t2);
    const double b = t2 < 1e-6 ? 0.5 - t2 * (1.0 / 24 - t2 / 720) : (1.0 - cos(t)) / t2;
    const double c = t2 < 1e-4 ? 1.0 / 6 - t2 * (1.0 / 120 - t2 / 5040) : (1.0 - sin(t) / t) / t2;
    double wv[3], wwv[3];
    exp3(w, R);
    cross(w, twist, wv);
    cross(w, wv, wwv);
    for (int i = 0; i < 3; i++) p[i] = twist[i] + b * wv[i] + c * wwv[i];
}

#endif
