/* Where the arms carry the object, and how fast: a product of joint frames whose z axes are the joints' axes. */

#include "functions.h"

/* Sine and cosine of a joint's position: from those of a position close by, to rounding, or from scratch. */
static inline void turn(const Core *c, int j, double x, double *s, double *co) {
    const double d = x - c->near_x[j], d2 = d * d;
    if (!(d2 < 2.5e-3)) {
        *s = sin(x), *co = cos(x);
        return;
    }
    const double sd = d * (1.0 - d2 * (1.0 / 6 - d2 * (1.0 / 120 - d2 / 5040)));
    const double cd = 1.0 - d2 * (0.5 - d2 * (1.0 / 24 - d2 * (1.0 / 720 - d2 / 40320)));
    *s = c->near_sin[j] * cd + c->near_cos[j] * sd;
    *co = c->near_cos[j] * cd - c->near_sin[j] * sd;
}

/* The positions that others are close to. */
static void stay_near(Core *c, const double *positions) {
    for (int j = 0; j < c->joints; j++) {
        c->near_x[j] = positions[j];
        c->near_sin[j] = sin(positions[j]), c->near_cos[j] = cos(positions[j]);
    }
}

/* From the frame of the joint before to that of joint j at position x. */
static void advance(const Core *c, int j, double x, double *R, double *p) {
    const double *link = c->link_p + 3 * j;
    double M[9];
    for (int i = 0; i < 3; i++) p[i] += dot3(R + 3 * i, link);
    multiply3(R, c->link_R + 9 * j, M);
    if (c->prismatic[j] != 0.0) {
        for (int i = 0; i < 3; i++) p[i] += x * M[3 * i + 2];
        memcpy(R, M, sizeof M);
        return;
    }
    double s, co;
    turn(c, j, x, &s, &co);
    for (int i = 0; i < 3; i++) {
        R[3 * i] = co * M[3 * i] + s * M[3 * i + 1];
        R[3 * i + 1] = co * M[3 * i + 1] - s * M[3 * i];
        R[3 * i + 2] = M[3 * i + 2];
    }
}

/* Rows of Jᵀ of one arm: what its joints do to a point, in world axes; and where it carries the object. */
static void follow_arm(const Core *c, int k, const double *positions, const double *about, double *O, double *jacobian) {
    double R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, p[3] = {0, 0, 0};
    const int start = (int)c->arm_start[k], end = start + (int)c->arm_size[k];
    for (int j = start; j < end; j++) {
        advance(c, j, positions[j], R, p);
        if (!jacobian) continue;
        double *row = jacobian + 6 * j, axis[3] = {R[2], R[5], R[8]};
        if (c->prismatic[j] != 0.0) {
            memcpy(row, axis, sizeof axis);
            row[3] = row[4] = row[5] = 0.0;
        } else {
            double arm[3] = {about[0] - p[0], about[1] - p[1], about[2] - p[2]};
            cross(axis, arm, row);
            memcpy(row + 3, axis, sizeof axis);
        }
    }
    if (!O) return;
    multiply3(R, c->object_R + 9 * k, O);
    for (int i = 0; i < 3; i++) O[9 + i] = p[i] + dot3(R + 3 * i, c->object_p + 3 * k);
}

static void carry(const Core *c, const double *positions, double *carried) {
    for (int k = 0; k < c->arms; k++) follow_arm(c, k, positions, NULL, carried + 12 * k, NULL);
}

static void carry_and_linearise(const Core *c, const double *positions, const double *about, double *carried,
                                double *jacobian) {
    for (int k = 0; k < c->arms; k++)
        follow_arm(c, k, positions, about, carried ? carried + 12 * k : NULL, jacobian);
}
