/* What the arithmetic works on: the addresses and lengths of a Workspace's arrays, in the order of compiled.py. */

#ifndef COOPQP_ARITHMETIC_H
#define COOPQP_ARITHMETIC_H

#include <stddef.h>
#include <stdint.h>

enum { NOMINAL = 0, RAY = 1, OPEN = 2 };
enum { DT, GRASP_GAIN, PATH_GAIN, SPEED, SPIN, HAS_MEASURED, HAS_PREDICTED, LAST_DT, ON_LINE, N_SCALARS };
#define MAX_JOINTS 16
/* Unknowns of the condensed QP, but for the null-space motions of redundant arms. */
#define TWIST_AND_SHARES 9

/* A Workspace. */
enum {
    B_PLACEMENTS, B_JACOBIAN, B_Y, B_JOINTS, B_STARTS, B_SIZES, B_SCALE, B_SHARES, B_LOW, B_HIGH, B_MAXSPEED,
    B_ACCELERATION, B_LOWER, B_UPPER, B_R, B_P, B_ALONG, B_PATH, B_MEASURED, B_POSITIONS, B_VPREV, B_NULL_ALONG,
    B_NULL_OFFSET, B_SCALARS, B_RESULT, B_ERRORS, B_GRASP, B_OFFSETS, B_PREDICTED, B_VELOCITY, B_ALONG_VELOCITY, B_MIDPOINT,
    B_LINE, B_PER_ACCELERATION, B_UNIT, B_BASE, B_COLUMNS, B_ROWS, B_NORMS, B_ROW_LOWER, B_ROW_UPPER, B_RECOVERY,
    B_OUTSIDE, B_COMMON, B_COUNT
};

/* A border of the preview. */
enum { SLOPE, BEFORE, POSITIONS, LOW, HIGH, PER_SPEED, PER_BEND, ACCELERATION, SLOPE_CHANGE, CURVATURE, RESULT, BORDER_COUNT };

/* The memory of an array: its address and its length in bytes. */
typedef struct {
    void *buf;
    ptrdiff_t len;
} View;

typedef struct {
    View view[B_COUNT];
    int arms, joints, redundant, accelerates, unknowns;
} Kernel;

typedef struct {
    View view[BORDER_COUNT];
    int joints, caps_speed;
} Border;

/* What a Kernel and a Border can do; see StepKernel and Border. */
typedef struct {
    int (*step)(Kernel *k, double cap, double clock, double span);
    int (*observe)(Kernel *k, double clock);
    int (*rows)(Kernel *k, double cap, double clock, double span);
    void (*border)(Border *b, double span);
} Arithmetic;

/* For any processor, and for one with AVX2 and FMA. */
extern const Arithmetic arithmetic_plain, arithmetic_avx2;

#define D(k, i) ((double *)(k)->view[i].buf)
#define L(k, i) ((int64_t *)(k)->view[i].buf)

#endif
