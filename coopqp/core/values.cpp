/* Singular values of LANES matrices, descending, by one-sided Jacobi rotations, accurate for small ones, too (entries
 * between 1e-40 and 1e40: it forms products of four). The values of one matrix do not depend on the others. Compiled once
 * more for processors with AVX2, in another namespace. */

#include <math.h>
#include <string.h>

#include "values.h"
#include "views.h"

#ifndef BUILD
#define BUILD plain
#endif

namespace BUILD {

#include "spatial.h"

#define ACROSS 1e-14 /* square of a cosine between vectors at right angles */

/* A number of each of several matrices. Loops over them are for the processor's vectors. */
using Lanes = double[LANES];

/* Sums of squares of the entries of vectors. */
static void squares_of(Lanes *x, int length, double *out) {
    for (int l = 0; l < LANES; l++) out[l] = 0.0;
    for (int j = 0; j < length; j++)
        for (int l = 0; l < LANES; l++) out[l] += x[j][l] * x[j][l];
}

/* Turn the vectors x and y into right angles where `going` is 1; note in `askew` where they were far from them. */
static void turn(Lanes *x, Lanes *y, int length, double *xx, double *yy, const double *going, double *askew) {
    Lanes xy = {0.0}, c, s;
    for (int j = 0; j < length; j++)
        for (int l = 0; l < LANES; l++) xy[l] += x[j][l] * y[j][l];
    for (int l = 0; l < LANES; l++) {
        const double square = xy[l] * xy[l], size = xx[l] * yy[l], half = 0.5 * (yy[l] - xx[l]);
        const double side = (half < 0.0 ? -1.0 : 1.0) * (square > 1e-30 * size ? going[l] : 0.0); /* 0: no turn */
        const double t = side * xy[l] / (fabs(half) + sqrt(square + half * half) + 1e-300);
        const double far = square > ACROSS * size ? going[l] : 0.0;
        askew[l] = maximum(askew[l], far);
        c[l] = 1.0 / sqrt(1.0 + t * t), s[l] = c[l] * t;
        xx[l] -= t * xy[l], yy[l] += t * xy[l];
    }
    for (int j = 0; j < length; j++)
        for (int l = 0; l < LANES; l++) {
            const double u = x[j][l], w = y[j][l];
            x[j][l] = c[l] * u - s[l] * w, y[j][l] = s[l] * u + c[l] * w;
        }
}

/* Put a value into values in descending order, of which there are `count`; its place. */
static int insert(double *values, int count, double value) {
    int k = count;
    for (; k > 0 && values[k - 1] < value; k--) values[k] = values[k - 1];
    values[k] = value;
    return k;
}

/* A matrix as vectors, the longest first (this saves a sweep): its rows, of a tall or square one its columns. */
static void longest_first(const double *A, int rows, int columns, int lane, Lanes *vectors) {
    const int wide = rows < columns, count = wide ? rows : columns, length = wide ? columns : rows;
    const int next = wide ? columns : 1, along = wide ? 1 : columns;
    double sizes[MOST_VALUES];
    int order[MOST_VALUES];
    for (int i = 0; i < count; i++) {
        double size = 0.0;
        for (int j = 0; j < length; j++) size += A[next * i + along * j] * A[next * i + along * j];
        const int k = insert(sizes, i, size);
        memmove(order + k + 1, order + k, sizeof(int) * (size_t)(i - k));
        order[k] = i;
    }
    for (int k = 0; k < count; k++)
        for (int i = order[k], j = 0; j < length; j++) vectors[length * k + j][lane] = A[next * i + along * j];
}

static void of_lanes(const double *const A[LANES], int rows, int columns, double *const values[LANES]) {
    const int wide = rows < columns, count = wide ? rows : columns, length = wide ? columns : rows;
    Lanes vectors[MOST_VALUES * MOST_ROWS], squares[MOST_VALUES], going, askew;
    double any = 1.0; /* whether vectors were far from right angles; if not, the values' errors are of ACROSS's square */
    for (int l = 0; l < LANES; l++) longest_first(A[l], rows, columns, l, vectors), askew[l] = 1.0;
    for (int sweep = 0; any != 0.0 && sweep < 30; sweep++) {
        for (int l = 0; l < LANES; l++) going[l] = askew[l], askew[l] = 0.0;
        for (int i = 0; i < count; i++) squares_of(vectors + length * i, length, squares[i]);
        for (int i = 0; i < count; i++)
            for (int k = i + 1; k < count; k++)
                turn(vectors + length * i, vectors + length * k, length, squares[i], squares[k], going, askew);
        any = 0.0;
        for (int l = 0; l < LANES; l++) any = maximum(any, askew[l]);
    }
    for (int i = 0; i < count; i++) squares_of(vectors + length * i, length, squares[i]);
    for (int l = 0; l < LANES; l++)
        for (int i = 0; i < count; i++) insert(values[l], i, sqrt(squares[i][l]));
}

void singular_values(const double *matrices, ptrdiff_t count, int rows, int columns, double *found) {
    const int width = rows < columns ? rows : columns;
    for (ptrdiff_t i = 0; i < count; i += LANES) {
        double spare[MOST_VALUES * LANES], *values[LANES];
        const double *A[LANES];
        for (int l = 0; l < LANES; l++) {
            const bool inside = i + l < count; /* lanes past the last matrix do it once more */
            A[l] = matrices + (inside ? i + l : count - 1) * rows * columns;
            values[l] = inside ? found + (i + l) * width : spare + MOST_VALUES * l;
        }
        of_lanes(A, rows, columns, values);
    }
}

}  // namespace BUILD
