/* Kinematics of one arm at many configurations, for Python: tool poses, Newton's method, walks along poses, derivatives
 * along a way; singular values of many matrices. See _arm.h for what the numbers are; batch_plain.py says the same in NumPy. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "_arm.h"

#define LANES 8 /* matrices whose singular values are found at once */
#define MOST_VALUES 6 /* of a matrix */
#define ACROSS 1e-14 /* square of a cosine between vectors at right angles */

/* -- singular values ------------------------------------------------------------------------------------------------- */

/* A number of each of several matrices. Loops over them are for the processor's vectors. */
typedef double Lanes[LANES];

/* Sums of squares of the entries of vectors. */
static void squares_of(Lanes *x, int length, double *out) {
    for (int l = 0; l < LANES; l++) out[l] = 0.0;
    for (int j = 0; j < length; j++)
        for (int l = 0; l < LANES; l++) out[l] += x[j][l] * x[j][l];
}

/* Turn the vectors x and y into right angles where `going` is 1; keep the largest square of a cosine between two. */
static void turn(Lanes *x, Lanes *y, int length, double *xx, double *yy, const double *going, double *largest) {
    Lanes xy = {0.0}, c, s;
    for (int j = 0; j < length; j++)
        for (int l = 0; l < LANES; l++) xy[l] += x[j][l] * y[j][l];
    for (int l = 0; l < LANES; l++) {
        const double square = xy[l] * xy[l], size = xx[l] * yy[l], half = 0.5 * (yy[l] - xx[l]);
        const double tangent = (half < 0.0 ? -xy[l] : xy[l]) / (fabs(half) + sqrt(square + half * half));
        const int turns = going[l] != 0.0 && square > 1e-30 * size; /* if not, quotients are of no account */
        const double t = turns ? tangent : 0.0, cosine = turns ? square / size : 0.0;
        largest[l] = cosine > largest[l] ? cosine : largest[l];
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

/* Singular values of LANES matrices, descending, by one-sided Jacobi rotations, accurate for small ones, too. The values
 * of one matrix do not depend on the others. */
static void singular_values(const double *const A[LANES], int rows, int columns, double *const values[LANES]) {
    const int wide = rows < columns, count = wide ? rows : columns, length = wide ? columns : rows;
    Lanes vectors[MOST_VALUES * MOST_JOINTS], squares[MOST_VALUES], going, largest;
    double most = 1.0; /* square of a cosine between two vectors; the values' errors are of the square of the last one */
    for (int l = 0; l < LANES; l++) longest_first(A[l], rows, columns, l, vectors), largest[l] = 1.0;
    for (int sweep = 0; most > ACROSS && sweep < 30; sweep++) {
        for (int l = 0; l < LANES; l++) going[l] = largest[l] > ACROSS, largest[l] = 0.0;
        for (int i = 0; i < count; i++) squares_of(vectors + length * i, length, squares[i]);
        for (int i = 0; i < count; i++)
            for (int k = i + 1; k < count; k++)
                turn(vectors + length * i, vectors + length * k, length, squares[i], squares[k], going, largest);
        most = 0.0;
        for (int l = 0; l < LANES; l++) most = fmax(most, largest[l]);
    }
    for (int i = 0; i < count; i++) squares_of(vectors + length * i, length, squares[i]);
    for (int l = 0; l < LANES; l++)
        for (int i = 0; i < count; i++) insert(values[l], i, sqrt(squares[i][l]));
}

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
    int rows, columns;
    (void)self;
    if (!PyArg_ParseTuple(args, "OiiO", objects, &rows, &columns, objects + 1)) return NULL;
    if (!take(objects, 2, 1, views, at, n)) return NULL;
    const int width = rows < columns ? rows : columns, length = rows < columns ? columns : rows;
    int good = width >= 1 && width <= MOST_VALUES && length <= MOST_JOINTS;
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
        singular_values(A, rows, columns, values);
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

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_batch", "Kinematics of one arm at many configurations.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__batch(void) { return PyModule_Create(&module); }
