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

/* Four numbers side by side, of which three are a vector; GCC and Clang make them what the processor has. */
typedef double quad __attribute__((vector_size(32)));
/* A frame in the world: its axes and its origin. */
struct Frame {
    quad x, y, z, p;
};

/* From the frame of the joint before to the frame of joint j at position x: R ← R C Rot(z, x), p ← p + R c. */
static inline void advance(const Core *c, int j, double x, Frame *f) {
    const double *C = c->link_R + 9 * j, *link = c->link_p + 3 * j;
    const quad mx = f->x * C[0] + f->y * C[3] + f->z * C[6], my = f->x * C[1] + f->y * C[4] + f->z * C[7];
    f->p += f->x * link[0] + f->y * link[1] + f->z * link[2];
    f->z = f->x * C[2] + f->y * C[5] + f->z * C[8];
    if (c->prismatic[j] != 0.0) {
        f->x = mx, f->y = my;
        f->p += f->z * x;
        return;
    }
    double s, co;
    turn(c, j, x, &s, &co);
    f->x = mx * co + my * s;
    f->y = my * co - mx * s;
}

/* Rows of Jᵀ of one arm, the twists that its joints give to a point, in world axes; and the object as it carries it. */
static void follow_arm(const Core *c, int k, const double *positions, const double *about, double *O, double *jacobian) {
    Frame f = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 0}};
    const int start = (int)c->arm_start[k], end = start + (int)c->arm_size[k];
    for (int j = start; j < end; j++) {
        advance(c, j, positions[j], &f);
        if (!jacobian) continue;
        double *row = jacobian + 6 * j, axis[3] = {f.z[0], f.z[1], f.z[2]};
        if (c->prismatic[j] != 0.0) {
            memcpy(row, axis, sizeof axis);
            row[3] = row[4] = row[5] = 0.0;
        } else {
            double arm[3] = {about[0] - f.p[0], about[1] - f.p[1], about[2] - f.p[2]};
            cross(axis, arm, row);
            memcpy(row + 3, axis, sizeof axis);
        }
    }
    if (!O) return;
    const double *Y = c->object_R + 9 * k, *y = c->object_p + 3 * k;
    for (int i = 0; i < 3; i++) {
        const double row[3] = {f.x[i], f.y[i], f.z[i]};
        for (int m = 0; m < 3; m++) O[3 * i + m] = row[0] * Y[m] + row[1] * Y[3 + m] + row[2] * Y[6 + m];
        O[9 + i] = f.p[i] + dot3(row, y);
    }
}

static void carry(const Core *c, const double *positions, double *carried) {
    for (int k = 0; k < c->arms; k++) follow_arm(c, k, positions, nullptr, carried + 12 * k, nullptr);
}

static void carry_and_linearise(const Core *c, const double *positions, const double *about, double *carried,
                                double *jacobian) {
    for (int k = 0; k < c->arms; k++)
        follow_arm(c, k, positions, about, carried ? carried + 12 * k : nullptr, jacobian);
}
