/* Where the arms carry the object, and how fast. */

#include "frames.h"
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

/* Columns of one arm's J, the twists that its joints give to a point, in world axes; and the object as it carries it. */
static void follow_arm(const Core *c, int k, const double *positions, const Vector3 *about, Pose *O, double *jacobian) {
    Frame f;
    const auto [start, n] = joints_of(c, k);
    for (int j = start; j < start + n; j++) {
        const bool slides = c->prismatic[j] != 0.0;
        double s = 0.0, co = 1.0;
        if (!slides) turn(c, j, positions[j], &s, &co);
        advance(f, c->link_R + 9 * j, c->link_p + 3 * j, slides, positions[j], s, co);
        if (jacobian) twist_of(f.axis(), f.origin(), slides, *about, jacobian + 6 * j);
    }
    if (O) *O = held_at(f, c->object[k]);
}

static void carry(const Core *c, const double *positions, Pose *carried) {
    for (int k = 0; k < c->arms; k++) follow_arm(c, k, positions, nullptr, carried + k, nullptr);
}

static void carry_and_linearise(const Core *c, const double *positions, const Vector3 &about, Pose *carried,
                                double *jacobian) {
    for (int k = 0; k < c->arms; k++) follow_arm(c, k, positions, &about, carried ? carried + k : nullptr, jacobian);
}
