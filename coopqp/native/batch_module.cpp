/* Kinematics of one arm at many configurations, for Python: tool poses, Newton's method, walks along poses, derivatives
 * along a way; singular values of many matrices (values.cpp). See arm.h for the layout of the numbers; batch_plain.py
 * says the same in NumPy. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "arm.h"
#include "values.h"

/* -- along poses ----------------------------------------------------------------------------------------------------- */

/* Whether det J of an arm of six joints is negative; 0 for other arms. */
static int orientation(const Arm *a, const double *q) {
    double T[12], A[6 * MOST_JOINTS];
    int order[6];
    if (a->joints != 6) return 0;
    place(a, q, T, A);
    return eliminate(A, order);
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
    for (int j = 0; j < a->joints; j++) furthest = maximum(furthest, fabs(next[j] - q[j]));
    if (residual <= tolerance && furthest <= longest && orientation(a, next) == orientation(a, q)) {
        memcpy(q, next, sizeof(double) * (size_t)a->joints);
        return 1;
    }
    if (halvings <= 0) return 0;
    halfway(from, to, between);
    return step_to(a, from, between, q, tolerance, longest, halvings - 1) &&
           step_to(a, between, to, q, tolerance, longest, halvings - 1);
}

/* The fastest that this processor can do. */
static SingularValues *fastest(void) {
#ifdef HAS_AVX2_ARITHMETIC
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return avx2::singular_values;
#endif
    return plain::singular_values;
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
        at[i] = static_cast<double *>(views[i].buf), length[i] = views[i].len / 8;
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

static PyObject *batch_derivatives(PyObject *self, PyObject *args) {
    PyObject *objects[6];
    Py_buffer views[6];
    double *at[6];
    Py_ssize_t n[6];
    Arm a;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOOOOO", objects, objects + 1, objects + 2, objects + 3, objects + 4, objects + 5))
        return NULL;
    if (!take(objects, 6, 2, views, at, n)) return NULL;
    const Py_ssize_t count = n[2] / 6;
    const int good = read_arm(at[0], n[0], &a) && a.joints >= 6 && n[2] == 6 * count && n[3] == n[2] &&
                     n[1] == a.joints * count && n[4] == n[1] && n[5] == n[1];
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0, j = 0; good && i < count; i++, j += a.joints)
        derivatives(&a, at[1] + j, at[2] + 6 * i, at[3] + 6 * i, at[4] + j, at[5] + j);
    Py_END_ALLOW_THREADS;
    if (!release(views, 6, good)) return NULL;
    Py_RETURN_NONE;
}

static PyObject *batch_singular_values(PyObject *self, PyObject *args) {
    PyObject *objects[2];
    Py_buffer views[2];
    double *at[2];
    Py_ssize_t n[2];
    SingularValues *find = fastest();
    int rows, columns;
    (void)self;
    if (!PyArg_ParseTuple(args, "OiiO", objects, &rows, &columns, objects + 1)) return NULL;
    if (!take(objects, 2, 1, views, at, n)) return NULL;
    const int width = rows < columns ? rows : columns, length = rows < columns ? columns : rows;
    int good = width >= 1 && width <= MOST_VALUES && length <= MOST_ROWS;
    const Py_ssize_t count = good ? n[1] / width : 0, size = (Py_ssize_t)rows * columns;
    good = good && n[1] == width * count && n[0] == size * count;
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; good && i < count; i += LANES) {
        double spare[MOST_VALUES * LANES], *values[LANES];
        const double *A[LANES];
        for (int l = 0; l < LANES; l++) {
            const int inside = i + l < count; /* lanes past the last matrix do it once more */
            A[l] = at[0] + (inside ? i + l : count - 1) * size;
            values[l] = inside ? at[1] + (i + l) * width : spare + MOST_VALUES * l;
        }
        find(A, rows, columns, values);
    }
    Py_END_ALLOW_THREADS;
    if (!release(views, 2, good)) return NULL;
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
    {"derivatives", batch_derivatives, METH_VARARGS, "derivatives(arm, q, twists, slopes of twists, slopes, curvatures)"},
    {"singular_values", batch_singular_values, METH_VARARGS, "singular_values(matrices, rows, columns, values)"},
    {"walk", batch_walk, METH_VARARGS, "walk(arm, poses, q, reached, tolerance, longest, halvings)"},
    {NULL, NULL, 0, NULL},
};

int add_batch(PyObject *module) { return PyModule_AddFunctions(module, methods); }
