/* Kinematics of one arm at many configurations: tool poses, Newton's method, walks along poses, singular values.
 *
 * An arm is 14 numbers per joint and 12 for its tool: rotation (9, row major) and origin (3) of the joint in the frame of
 * the one before, both with the z axis along the joint's axis; 1 if it slides; its weight. The tool is R (9), p (3) in
 * the last joint. Poses are R (9), p (3) in the world, Jacobians are transposed (joints, 6): [linear; angular] of the
 * tool's point in world axes. batch_plain.py says the same in NumPy. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <string.h>

#include "../control/core/spatial.h"

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

typedef struct {
    int joints;
    const double *numbers, *tool;
} Arm;

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

/* Rotation vector of R, any angle up to half a turn: from the largest entry of its quaternion. */
static void rotation_vector(const double *R, double *w) {
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

/* What leads from T to the target: displacement and rotation vector in world axes. Returns the largest entry. */
static double error_of(const double *T, const double *target, double *e) {
    double D[9], largest = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) D[3 * i + j] = dot3(target + 3 * i, T + 3 * j);
    rotation_vector(D, e + 3);
    for (int i = 0; i < 3; i++) e[i] = target[9 + i] - T[9 + i];
    for (int i = 0; i < 6; i++) largest = fmax(largest, fabs(e[i]));
    return isfinite(e[0] + e[1] + e[2] + e[3] + e[4] + e[5]) ? largest : INFINITY;
}

/* v = W² J' (J W² J' + damping I)⁻¹ e; returns the largest step, infinite if there is none. */
static double newton_step(const Arm *a, const double *jacobian, const double *e, double damping, double *v) {
    double G[36], y[6], largest = 0.0, trace = 0.0;
    memset(G, 0, sizeof G);
    for (int j = 0; j < a->joints; j++) {
        const double *row = jacobian + 6 * j, weight = a->numbers[PER_JOINT * j + WEIGHT], w2 = weight * weight;
        UNROLL for (int i = 0; i < 6; i++) {
            const double x = w2 * row[i];
            UNROLL for (int m = 0; m < 6; m++) G[6 * i + m] += x * row[m];
        }
    }
    UNROLL for (int i = 0; i < 6; i++) trace += G[7 * i];
    damping += LEAST_DAMPING * trace;
    UNROLL for (int i = 0; i < 6; i++) G[7 * i] += damping, y[i] = e[i];
    UNROLL for (int k = 0; k < 6; k++) { /* Cholesky with the right-hand side; the diagonal holds inverses */
        if (!(G[7 * k] > 0.0)) return INFINITY;
        const double inverse = 1.0 / sqrt(G[7 * k]);
        G[7 * k] = inverse, y[k] *= inverse;
        UNROLL for (int i = k + 1; i < 6; i++) G[6 * k + i] *= inverse, y[i] -= G[6 * k + i] * y[k];
        UNROLL for (int i = k + 1; i < 6; i++)
            UNROLL for (int m = i; m < 6; m++) G[6 * i + m] -= G[6 * k + i] * G[6 * k + m];
    }
    UNROLL for (int i = 5; i >= 0; i--) {
        UNROLL for (int k = i + 1; k < 6; k++) y[i] -= G[6 * i + k] * y[k];
        y[i] *= G[7 * i];
    }
    for (int j = 0; j < a->joints; j++) {
        const double *row = jacobian + 6 * j, weight = a->numbers[PER_JOINT * j + WEIGHT];
        v[j] = weight * weight * (dot3(row, y) + dot3(row + 3, y + 3));
        largest = fmax(largest, fabs(v[j]));
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

/* Singular values of the tool's Jacobian, descending, by one-sided Jacobi rotations (accurate for small ones, too). */
static void singular_values(const Arm *a, const double *q, double *values) {
    double T[12], jacobian[6 * MOST_JOINTS], X[6 * MOST_JOINTS];
    const int n = a->joints, count = n < 6 ? n : 6, length = n < 6 ? 6 : n;
    place(a, q, T, jacobian);
    for (int i = 0; i < count; i++)
        for (int j = 0; j < length; j++) X[length * i + j] = n < 6 ? jacobian[6 * i + j] : jacobian[6 * j + i];
    double squares[6], largest = 1.0; /* cosine between two vectors; the values' errors are of the square of the last one */
    for (int sweep = 0; largest > 1e-7 && sweep < 30; sweep++) {
        largest = 0.0;
        for (int i = 0; i < count; i++) {
            squares[i] = 0.0;
            for (int j = 0; j < length; j++) squares[i] += X[length * i + j] * X[length * i + j];
        }
        for (int i = 0; i < count; i++)
            for (int k = i + 1; k < count; k++) {
                double *x = X + length * i, *y = X + length * k, xy = 0.0;
                for (int j = 0; j < length; j++) xy += x[j] * y[j];
                const double size = squares[i] * squares[k];
                if (!(xy * xy > 1e-30 * size)) continue;
                if (xy * xy > largest * largest * size) largest = fabs(xy) / sqrt(size);
                const double half = 0.5 * (squares[k] - squares[i]);
                const double t = (half < 0.0 ? -xy : xy) / (fabs(half) + sqrt(xy * xy + half * half));
                const double c = 1.0 / sqrt(1.0 + t * t), s = c * t;
                squares[i] -= t * xy, squares[k] += t * xy;
                for (int j = 0; j < length; j++) {
                    const double u = x[j];
                    x[j] = c * u - s * y[j], y[j] = s * u + c * y[j];
                }
            }
    }
    for (int i = 0; i < count; i++) {
        double square = 0.0;
        for (int j = 0; j < length; j++) square += X[length * i + j] * X[length * i + j];
        int k = i;
        for (; k > 0 && values[k - 1] < sqrt(square); k--) values[k] = values[k - 1];
        values[k] = sqrt(square);
    }
}

/* -- along poses ----------------------------------------------------------------------------------------------------- */

/* Whether det J of an arm of six joints is negative; 0 for other arms. */
static int orientation(const Arm *a, const double *q) {
    double T[12], A[6 * MOST_JOINTS];
    int negative = 0;
    if (a->joints != 6) return 0;
    place(a, q, T, A);
    for (int k = 0; k < 6; k++) {
        int pivot = k;
        for (int i = k + 1; i < 6; i++)
            if (fabs(A[6 * i + k]) > fabs(A[6 * pivot + k])) pivot = i;
        for (int j = k; pivot != k && j < 6; j++) {
            const double other = A[6 * pivot + j];
            A[6 * pivot + j] = A[6 * k + j], A[6 * k + j] = other;
        }
        negative ^= (pivot != k) ^ (A[7 * k] < 0.0);
        for (int i = k + 1; i < 6; i++) {
            const double f = A[6 * i + k] / A[7 * k];
            for (int j = k; j < 6; j++) A[6 * i + j] -= f * A[6 * k + j];
        }
    }
    return negative;
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
    for (int j = 0; j < a->joints; j++) furthest = fmax(furthest, fabs(next[j] - q[j]));
    if (residual <= tolerance && furthest <= longest && orientation(a, next) == orientation(a, q)) {
        memcpy(q, next, sizeof(double) * (size_t)a->joints);
        return 1;
    }
    if (halvings <= 0) return 0;
    halfway(from, to, between);
    return step_to(a, from, between, q, tolerance, longest, halvings - 1) &&
           step_to(a, between, to, q, tolerance, longest, halvings - 1);
}

/* -- Python ---------------------------------------------------------------------------------------------------------- */

/* The numbers of contiguous float64 buffers, the last `writable` of them to write to. */
static int take(PyObject *const *objects, int count, int writable, Py_buffer *views, double **at, Py_ssize_t *length) {
    for (int i = 0; i < count; i++) {
        const int flags = PyBUF_FORMAT | PyBUF_C_CONTIGUOUS | (i >= count - writable ? PyBUF_WRITABLE : 0);
        int good = PyObject_GetBuffer(objects[i], views + i, flags) == 0;
        if (good && !(views[i].itemsize == 8 && views[i].format && views[i].format[0] == 'd' && !views[i].format[1])) {
            PyBuffer_Release(views + i);
            PyErr_SetString(PyExc_ValueError, "expected contiguous arrays of float64");
            good = 0;
        }
        if (!good) {
            while (i--) PyBuffer_Release(views + i);
            return 0;
        }
        at[i] = views[i].buf, length[i] = views[i].len / 8;
    }
    return 1;
}

static int release(Py_buffer *views, int count, int good) {
    for (int i = 0; i < count; i++) PyBuffer_Release(views + i);
    if (!good) PyErr_SetString(PyExc_ValueError, "the arrays do not fit together");
    return good;
}

static int read_arm(const double *numbers, Py_ssize_t length, Arm *a) {
    const Py_ssize_t joints = (length - 12) / PER_JOINT;
    if (joints < 1 || joints > MOST_JOINTS || length != PER_JOINT * joints + 12) return 0;
    a->joints = (int)joints, a->numbers = numbers, a->tool = numbers + PER_JOINT * joints;
    return 1;
}

static PyObject *batch_place(PyObject *self, PyObject *args) {
    PyObject *objects[4];
    Py_buffer views[4];
    double *at[4];
    Py_ssize_t n[4];
    Arm a;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOOO", objects, objects + 1, objects + 2, objects + 3)) return NULL;
    if (!take(objects, 4, 2, views, at, n)) return NULL;
    const Py_ssize_t count = n[2] / 12;
    const int good = read_arm(at[0], n[0], &a) && n[2] == 12 * count && n[1] == a.joints * count && n[3] == 6 * n[1];
    for (Py_ssize_t i = 0; good && i < count; i++)
        place(&a, at[1] + i * a.joints, at[2] + 12 * i, at[3] + 6 * i * a.joints);
    if (!release(views, 4, good)) return NULL;
    Py_RETURN_NONE;
}

static PyObject *batch_solve(PyObject *self, PyObject *args) {
    PyObject *objects[4];
    Py_buffer views[4];
    double *at[4], tolerance, longest, damping;
    Py_ssize_t n[4];
    int steps;
    Arm a;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOOOdidd", objects, objects + 1, objects + 2, objects + 3, &tolerance, &steps, &longest,
                          &damping))
        return NULL;
    if (!take(objects, 4, 2, views, at, n)) return NULL;
    const Py_ssize_t count = n[3];
    const int good = read_arm(at[0], n[0], &a) && n[1] == 12 * count && n[2] == a.joints * count;
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; good && i < count; i++)
        at[3][i] = solve(&a, at[1] + 12 * i, at[2] + i * a.joints, tolerance, steps, longest, damping);
    Py_END_ALLOW_THREADS;
    if (!release(views, 4, good)) return NULL;
    Py_RETURN_NONE;
}

static PyObject *batch_singular_values(PyObject *self, PyObject *args) {
    PyObject *objects[3];
    Py_buffer views[3];
    double *at[3];
    Py_ssize_t n[3];
    Arm a;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOO", objects, objects + 1, objects + 2)) return NULL;
    if (!take(objects, 3, 1, views, at, n)) return NULL;
    int good = read_arm(at[0], n[0], &a);
    const int width = good && a.joints < 6 ? a.joints : 6;
    const Py_ssize_t count = n[2] / width;
    good = good && n[2] == width * count && n[1] == a.joints * count;
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; good && i < count; i++) singular_values(&a, at[1] + i * a.joints, at[2] + i * width);
    Py_END_ALLOW_THREADS;
    if (!release(views, 3, good)) return NULL;
    Py_RETURN_NONE;
}

static PyObject *batch_walk(PyObject *self, PyObject *args) {
    PyObject *objects[4];
    Py_buffer views[4];
    double *at[4], tolerance, longest;
    Py_ssize_t n[4];
    int halvings;
    Arm a;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOOOddi", objects, objects + 1, objects + 2, objects + 3, &tolerance, &longest,
                          &halvings))
        return NULL;
    if (!take(objects, 4, 2, views, at, n)) return NULL;
    const Py_ssize_t poses = n[1] / 12, count = n[3];
    const int good = read_arm(at[0], n[0], &a) && n[1] == 12 * poses && poses > 0 && n[2] == count * poses * a.joints;
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; good && i < count; i++) {
        double *q = at[2] + i * poses * a.joints;
        const size_t size = sizeof(double) * (size_t)a.joints;
        Py_ssize_t k = 1;
        for (; k < poses; k++, q += a.joints) {
            memcpy(q + a.joints, q, size);
            if (!step_to(&a, at[1] + 12 * (k - 1), at[1] + 12 * k, q + a.joints, tolerance, longest, halvings)) break;
        }
        at[3][i] = (double)(k - 1);
        for (; k < poses; k++, q += a.joints) memcpy(q + a.joints, q, size);
    }
    Py_END_ALLOW_THREADS;
    if (!release(views, 4, good)) return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"place", batch_place, METH_VARARGS, "place(arm, q, poses, jacobians)"},
    {"solve", batch_solve, METH_VARARGS, "solve(arm, poses, q, residuals, tolerance, steps, longest, damping)"},
    {"singular_values", batch_singular_values, METH_VARARGS, "singular_values(arm, q, values)"},
    {"walk", batch_walk, METH_VARARGS, "walk(arm, poses, q, reached, tolerance, longest, halvings)"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_batch", "Kinematics of one arm at many configurations.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__batch(void) { return PyModule_Create(&module); }
