/* Poses, and their logarithm and exponential. */

#ifndef COOPQP_SPATIAL_H
#define COOPQP_SPATIAL_H

#include <math.h>

#include "views.h"

/* One instruction each, where fmax and fmin are calls. A `y` that is no number counts for nothing. */
static inline double maximum(double x, double y) { return y > x ? y : x; }
static inline double minimum(double x, double y) { return y < x ? y : x; }
/* As fmax and fmin: of a number and of none the number. */
static inline double max_of(double x, double y) { return x > y || !(y == y) ? x : y; }
static inline double min_of(double x, double y) { return x < y || !(y == y) ? x : y; }

static inline double clamp(double x, double low, double high) { return x < low ? low : (x > high ? high : x); }

/* A B */
static inline Pose compose(const Pose &A, const Pose &B) { return {A.R * B.R, A.p + A.R * B.p}; }
/* A⁻¹ B */
static inline Pose between(const Pose &A, const Pose &B) {
    return {A.R.transpose() * B.R, A.R.transpose() * (B.p - A.p)};
}

/* B A⁻¹: the motion in the common frame that leads A to B */
static inline Pose from_to(const Pose &A, const Pose &B) {
    const Matrix3 R = B.R * A.R.transpose();
    return {R, B.p - R * A.p};
}

/* [linear; angular] */
static inline Vector6 both(const Vector3 &linear, const Vector3 &angular) {
    Vector6 out;
    out.head<3>() = linear, out.tail<3>() = angular;
    return out;
}

/* A twist in the axes of another frame that R turns into these. */
static inline Vector6 turned(const Matrix3 &R, const Vector6 &twist) { return both(R * twist.head<3>(), R * twist.tail<3>()); }
static inline Vector6 turned_back(const Matrix3 &R, const Vector6 &twist) {
    return both(R.transpose() * twist.head<3>(), R.transpose() * twist.tail<3>());
}

/* Largest size of n numbers. */
static inline double largest_size(const double *x, int n) {
    double largest = 0.0;
    for (int j = 0; j < n; j++) largest = maximum(largest, fabs(x[j]));
    return largest;
}

/* Rotation of a rotation vector (Rodrigues). */
static inline Matrix3 exp3(const Vector3 &w) {
    const double t2 = w.squaredNorm(), t = sqrt(t2), small = t2 < 1e-6;
    const double a = small ? 1.0 - t2 * (1.0 / 6 - t2 / 120) : sin(t) / t;                /* sin θ / θ */
    const double b = small ? 0.5 - t2 * (1.0 / 24 - t2 / 720) : (1.0 - cos(t)) / t2;      /* (1 − cos θ) / θ² */
    Matrix3 R = b * w * w.transpose();
    R.diagonal().array() += 1.0 - b * t2;
    R(0, 1) -= a * w[2], R(1, 0) += a * w[2];
    R(0, 2) += a * w[1], R(2, 0) -= a * w[1];
    R(1, 2) -= a * w[0], R(2, 1) += a * w[0];
    return R;
}

/* Rotation vector of R, any angle up to half a turn: from the largest entry of its quaternion. */
static inline Vector3 rotation_vector(const Matrix3 &R) {
    const Vector3 diagonal = R.diagonal();
    double x[4] = {1.0 + diagonal.sum()};
    for (int i = 0; i < 3; i++) x[1 + i] = 1.0 + 2.0 * diagonal[i] - diagonal.sum();
    int k = 0;
    for (int i = 1; i < 4; i++)
        if (x[i] > x[k]) k = i;
    const double a = R(2, 1) - R(1, 2), b = R(0, 2) - R(2, 0), c = R(1, 0) - R(0, 1);
    const double d = R(1, 0) + R(0, 1), e = R(0, 2) + R(2, 0), f = R(2, 1) + R(1, 2);
    const double rows[4][4] = {{x[0], a, b, c}, {a, x[1], d, e}, {b, d, x[2], f}, {c, e, f, x[3]}};
    const Vector3 v(rows[k][1], rows[k][2], rows[k][3]);
    const double norm = v.norm(), sign = rows[k][0] < 0.0 ? -1.0 : 1.0;
    return (sign * (norm > 0.0 ? 2.0 * atan2(norm, sign * rows[k][0]) / norm : 0.0)) * v;
}

/* V⁻¹(ω) p = p − ½ ω×p + (1 − θ/2 cot(θ/2)) / θ² ω×(ω×p) */
static inline Vector3 unroll(const Vector3 &omega, double third, const Vector3 &p) {
    const Vector3 wp = omega.cross(p);
    return p - 0.5 * wp + third * omega.cross(wp);
}

/* Twist of a placement; false near half a turn, or for numbers that are not finite. */
static inline bool log6(const Pose &T, Ref6 e) {
    const Matrix3 &R = T.R;
    const Vector3 w(0.5 * (R(2, 1) - R(1, 2)), 0.5 * (R(0, 2) - R(2, 0)), 0.5 * (R(1, 0) - R(0, 1)));
    const double s2 = w.squaredNorm(), c = 0.5 * (R.trace() - 1.0);
    double ratio, third; /* θ / sin θ, and (1 − θ cot(θ/2) / 2) / θ² */
    if (!(c > -0.9)) return false;
    if (s2 < 4e-4 && c > 0.0) {
        ratio = 1.0 + s2 * (1.0 / 6 + s2 * (3.0 / 40 + s2 * (5.0 / 112)));
        const double t2 = s2 * ratio * ratio;
        third = 1.0 / 12 + t2 * (1.0 / 720 + t2 / 30240);
    } else {
        const double s = sqrt(s2), theta = atan2(s, c);
        ratio = theta / s;
        third = (1.0 - 0.5 * theta * s / (1.0 - c)) / (theta * theta);
    }
    const Vector3 omega = ratio * w, v = unroll(omega, third, T.p);
    e = both(v, omega);
    return isfinite(v[0]) && isfinite(v[1]) && isfinite(v[2]);
}

/* The same of any placement, near half a turn, too. */
static inline Vector6 any_log6(const Pose &T) {
    Vector6 e;
    if (log6(T, e)) return e;
    const Vector3 omega = rotation_vector(T.R);
    const double theta = omega.norm();
    return both(unroll(omega, (1.0 - 0.5 * theta / tan(0.5 * theta)) / (theta * theta), T.p), omega);
}

/* exp of a twist */
static inline Pose exp6(const Vector6 &twist) {
    const Vector3 v = twist.head<3>(), w = twist.tail<3>();
    const double t2 = w.squaredNorm(), t = sqrt(t2);
    const double b = t2 < 1e-6 ? 0.5 - t2 * (1.0 / 24 - t2 / 720) : (1.0 - cos(t)) / t2;
    const double c = t2 < 1e-4 ? 1.0 / 6 - t2 * (1.0 / 120 - t2 / 5040) : (1.0 - sin(t) / t) / t2;
    const Vector3 wv = w.cross(v);
    return {exp3(w), v + b * wv + c * w.cross(wv)};
}

#endif
