/* Where the arms carry the object, and how fast. */

#include "frames.h"
#include "functions.h"

constexpr double CLOSE_BY = 0.05; /* from here on sine and cosine are not those of a position close by [rad] */

/* Sine and cosine of a joint's position: from those of a position close by, to rounding, or from scratch. */
static inline void turn(const Core *c, int j, double x, double *s, double *co) {
    const double d = x - c->near_x[j], d2 = d * d;
    if (!(d2 < CLOSE_BY * CLOSE_BY)) {
        *s = sin(x), *co = cos(x);
        return;
    }
    const double sd = d * (1.0 - d2 * (1.0 / 6 - d2 * (1.0 / 120 - d2 * (1.0 / 5040))));
    const double cd = 1.0 - d2 * (0.5 - d2 * (1.0 / 24 - d2 * (1.0 / 720 - d2 * (1.0 / 40320))));
    *s = c->near_sin[j] * cd + c->near_cos[j] * sd;
    *co = c->near_cos[j] * cd - c->near_sin[j] * sd;
}

/* Take positions as those that others are close to, of each joint that has moved further than `most` from the last. */
static void keep_sines(Core *c, const double *positions, double most) {
    for (int j = 0; j < c->joints; j++) {
        const double x = positions[j];
        if (fabs(x - c->near_x[j]) <= most) continue;
        const double s = sin(x), co = cos(x);
        c->near_x[j] = x, c->near_sin[j] = s, c->near_cos[j] = co;
    }
}

/* Over joint j: the frame behind it, and with COLUMNS its column of J. */
template <bool COLUMNS>
static inline void pass_joint(const Core *c, int j, const double *positions, const Vector3 *about, Frame &f, double *jacobian) {
    const double pitch = c->pitch[j];
    const bool slides = pitch == INFINITY;
    double s = 0.0, co = 1.0;
    if (!slides) turn(c, j, positions[j], &s, &co);
    advance(f, c->link_R + 9 * j, c->link_p + 3 * j, slides, positions[j], s, co);
    if (COLUMNS) twist_of(f.axis(), f.origin(), slides, *about, jacobian + 6 * j);
    if (pitch != 0.0 && !slides) {
        f.p += f.z * (pitch * positions[j]);
        if (COLUMNS) Eigen::Map<Vector3>(jacobian + 6 * j) += pitch * f.axis();
    }
}

/* Columns of J of an arm's own joints, the twists that they give to a point, in world axes; and the object as it carries it. From
 * the frame before them. */
template <bool COLUMNS>
static inline void follow_own(const Core *c, int k, Frame f, const double *positions, const Vector3 *about, Pose *O,
                              double *jacobian) {
    const ArmJoints &a = joints_of(c, k);
    if (a.in_line)
        for (int j = a.start; j < a.start + a.n; j++) pass_joint<COLUMNS>(c, j, positions, about, f, jacobian);
    else
        for (int i = 0; i < a.n; i++) pass_joint<COLUMNS>(c, a.own(i), positions, about, f, jacobian);
    if (O) *O = held_at(f, c->object[k]);
}

/* The same of all joints that move its tool, which may be shared. */
template <bool COLUMNS>
static void follow_arm(const Core *c, int k, const double *positions, const Vector3 *about, Pose *O, double *jacobian) {
    Frame f;
    for (int i = 0; i < shared_before(c, k); i++) pass_joint<COLUMNS>(c, joint_behind(c, k, i), positions, about, f, jacobian);
    follow_own<COLUMNS>(c, k, f, positions, about, O, jacobian);
}

/* Whether the joints of arm k are followed by themselves: not where all arms of a group have the same joints before their own. */
static bool by_itself(const Core *c, int k) { return !group_of(c, k) || !group_of(c, k)->in_line; }

template <bool COLUMNS>
static void follow_groups(const Core *c, const double *positions, const Vector3 *about, Pose *carried, double *jacobian) {
    for (int i = 0; i < c->groups; i++) {
        const Group &g = c->group[i];
        Frame f;
        if (!g.in_line) continue;
        for (int j = 0; j < g.shared; j++) pass_joint<COLUMNS>(c, g.joint[j], positions, about, f, jacobian);
        for (int j = 0; j < g.arms; j++)
            follow_own<COLUMNS>(c, g.arm[j], f, positions, about, carried ? carried + g.arm[j] : nullptr, jacobian);
    }
}

static void carry(const Core *c, const double *positions, Pose *carried) {
    for (int k = 0; k < c->arms; k++)
        if (by_itself(c, k)) follow_arm<false>(c, k, positions, nullptr, carried + k, nullptr);
    follow_groups<false>(c, positions, nullptr, carried, nullptr);
    carry_with_others(c, carried);
}

static void carry_and_linearise(const Core *c, const double *positions, const Vector3 &about, Pose *carried,
                                double *jacobian) {
    for (int k = 0; k < c->arms; k++)
        if (by_itself(c, k)) follow_arm<true>(c, k, positions, &about, carried ? carried + k : nullptr, jacobian);
    follow_groups<true>(c, positions, &about, carried, jacobian);
    if (carried) carry_with_others(c, carried);
}
