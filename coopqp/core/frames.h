/* Kinematics of the joints of an arm, for a step (kinematics.cpp) and for many configurations (arm.h): a product of joint
 * frames whose z axes are the joints' axes. */

#ifndef COOPQP_FRAMES_H
#define COOPQP_FRAMES_H

#include "spatial.h"

/* Four numbers side by side, of which three are a vector: one of the processor's vectors where it has such long ones. */
#if defined(__AVX__) && defined(__GNUC__)
typedef double quad __attribute__((vector_size(32)));
#else
using quad = Eigen::Vector4d;
#endif

/* A frame in the world: its axes and its origin. */
struct Frame {
    quad x = {1.0, 0.0, 0.0, 0.0}, y = {0.0, 1.0, 0.0, 0.0}, z = {0.0, 0.0, 1.0, 0.0}, p = {0.0, 0.0, 0.0, 0.0};

    Vector3 axis() const { return {z[0], z[1], z[2]}; }
    Vector3 origin() const { return {p[0], p[1], p[2]}; }
};

/* From the frame of the joint before to that of a joint at position x, of sine s and cosine co: R ← R C Rot(z, x),
 * p ← p + R c. A joint that slides needs no sine. */
static inline void advance(Frame &f, const double *C, const double *c, bool slides, double x, double s, double co) {
    const quad mx = f.x * C[0] + f.y * C[3] + f.z * C[6], my = f.x * C[1] + f.y * C[4] + f.z * C[7];
    f.p += f.x * c[0] + f.y * c[1] + f.z * c[2];
    f.z = f.x * C[2] + f.y * C[5] + f.z * C[8];
    if (slides) {
        f.x = mx, f.y = my;
        f.p += f.z * x;
    } else {
        f.x = mx * co + my * s;
        f.y = my * co - mx * s;
    }
}

/* The twist of a point, in world axes, that a joint gives what it carries. */
static inline void twist_of(const Vector3 &axis, const Vector3 &origin, bool slides, const Vector3 &point, double *twist) {
    Eigen::Map<Vector3> linear(twist), angular(twist + 3);
    if (slides) linear = axis, angular.setZero();
    else linear = axis.cross(point - origin), angular = axis;
}

/* What is held at Y in a frame. */
static inline Pose held_at(const Frame &f, const Pose &Y) {
    Matrix3 R;
    for (int i = 0; i < 3; i++) R.row(i) << f.x[i], f.y[i], f.z[i];
    return {R * Y.R, f.origin() + R * Y.p};
}

#endif
