/* Lower bounds of distances that follow the joints; bounds_plain.py says the same in NumPy. Reaches are (nv, P): the
 * pairs of one joint stand in a row, for the processor's vectors. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>

#define MOST 6
#define LANES 8
#define TURN 6.283185307179586

/* -- arithmetic ------------------------------------------------------------------------------------------------------ */

/* Rooms lose what the way of the joints may take. */
static void follow(double *rooms, const double *reach, double *positions, const double *x, const double *continuous,
                   Py_ssize_t pairs, Py_ssize_t joints) {
    for (Py_ssize_t j = 0; j < joints; j++) {
        const double *own = reach + j * pairs;
        double way = fabs(x[j] - positions[j]);
        if (continuous[j] != 0.0 && fabs(TURN - way) < way) way = fabs(TURN - way);
        positions[j] = x[j];
        if (way != 0.0)
            for (Py_ssize_t k = 0; k < pairs; k++) rooms[k] -= own[k] * way;
    }
}

/* Largest reach over room, per joint; 0 if a room is none. `shares` is memory for one number per pair. */
static int certify(const double *rooms, const double *reach, double spare, double *shares, double *out,
                   Py_ssize_t pairs, Py_ssize_t joints) {
    for (Py_ssize_t j = 0; j < joints; j++) out[j] = 0.0;
    for (Py_ssize_t k = 0; k < pairs; k++) {
        if (!(rooms[k] > spare)) return 0;
        shares[k] = 1.0 / (rooms[k] - spare);
    }
    for (Py_ssize_t j = 0; j < joints; j++) {
        const double *own = reach + j * pairs;
        double most[LANES] = {0.0};
        for (Py_ssize_t k = 0; k < pairs; k += LANES) {
            const int some = pairs - k < LANES ? (int)(pairs - k) : LANES;
            for (int l = 0; l < some; l++) {
                const double share = own[k + l] * shares[k + l];
                most[l] = share > most[l] ? share : most[l];
            }
        }
        for (int l = 0; l < LANES; l++) out[j] = most[l] > out[j] ? most[l] : out[j];
    }
    return 1;
}

/* G (joints) of a pair with unit normal and point in `ends` (6), by the joints' world Jacobians J (joints, 6). */
static void gradient(const double *ends, const double *J, const double *kinds, double *G, Py_ssize_t joints) {
    const double *n = ends, *p = ends + 3;
    const double turn[3] = {p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]};
    for (Py_ssize_t j = 0; j < joints; j++) {
        const double *a = J + 6 * j;
        const double move = n[0] * a[0] + n[1] * a[1] + n[2] * a[2];
        G[j] = kinds[j] * (move + turn[0] * a[3] + turn[1] * a[4] + turn[2] * a[5]);
    }
}

/* -- Python ---------------------------------------------------------------------------------------------------------- */

/* Hold `count` contiguous float64 arrays; 0 and an exception if they are something else. */
static int take(PyObject **objects, int count, Py_buffer *views, double **at, Py_ssize_t *n) {
    for (int i = 0; i < count; i++) {
        if (PyObject_GetBuffer(objects[i], views + i, PyBUF_FORMAT | PyBUF_C_CONTIGUOUS) == 0) {
            if (views[i].itemsize == 8 && views[i].format && views[i].format[0] == 'd' && !views[i].format[1]) {
                at[i] = views[i].buf, n[i] = views[i].len / 8;
                continue;
            }
            PyErr_SetString(PyExc_ValueError, "expected contiguous arrays of float64");
            i++;
        }
        while (i--) PyBuffer_Release(views + i);
        return 0;
    }
    return 1;
}

static void release(Py_buffer *views, int count) {
    while (count--) PyBuffer_Release(views + count);
}

static PyObject *misfit(void) {
    PyErr_SetString(PyExc_ValueError, "the arrays do not fit together");
    return NULL;
}

static PyObject *bounds_follow(PyObject *self, PyObject *args) {
    PyObject *objects[MOST];
    Py_buffer views[MOST];
    double *at[MOST];
    Py_ssize_t n[MOST];
    (void)self;
    if (!PyArg_ParseTuple(args, "OOOOO", objects, objects + 1, objects + 2, objects + 3, objects + 4) ||
        !take(objects, 5, views, at, n))
        return NULL;
    const int good = n[1] == n[0] * n[2] && n[3] == n[2] && n[4] == n[2] && !views[0].readonly && !views[2].readonly;
    if (good) follow(at[0], at[1], at[2], at[3], at[4], n[0], n[2]);
    release(views, 5);
    if (!good) return misfit();
    Py_RETURN_NONE;
}

static PyObject *bounds_certify(PyObject *self, PyObject *args) {
    PyObject *objects[MOST];
    Py_buffer views[MOST];
    double *at[MOST], spare;
    Py_ssize_t n[MOST];
    int found = 0;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOdOO", objects, objects + 1, &spare, objects + 2, objects + 3) ||
        !take(objects, 4, views, at, n))
        return NULL;
    const int good = n[2] == n[0] && n[1] == n[0] * n[3] && !views[2].readonly && !views[3].readonly;
    if (good) found = certify(at[0], at[1], spare, at[2], at[3], n[0], n[3]);
    release(views, 4);
    return good ? PyBool_FromLong(found) : misfit();
}

static PyObject *bounds_near(PyObject *self, PyObject *args) {
    PyObject *objects[MOST];
    Py_buffer views[MOST];
    double *at[MOST];
    Py_ssize_t n[MOST];
    (void)self;
    if (!PyArg_ParseTuple(args, "OO", objects, objects + 1) || !take(objects, 2, views, at, n)) return NULL;
    const int good = n[1] == n[0];
    PyObject *found = good ? PyList_New(0) : misfit();
    for (Py_ssize_t k = 0; found && k < n[0]; k++) {
        if (at[0][k] >= at[1][k]) continue;
        PyObject *number = PyLong_FromSsize_t(k);
        if (!number || PyList_Append(found, number) < 0) Py_CLEAR(found);
        Py_XDECREF(number);
    }
    release(views, 2);
    return found;
}

static PyObject *bounds_soonest(PyObject *self, PyObject *args) {
    PyObject *objects[MOST];
    Py_buffer views[MOST];
    double *at[MOST], least, most = -1.0;
    Py_ssize_t n[MOST], found = -1;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOd", objects, objects + 1, &least) || !take(objects, 2, views, at, n)) return NULL;
    const int good = n[1] == n[0] && n[0] > 0;
    for (Py_ssize_t k = 0; good && k < n[0]; k++) {
        const double room = at[0][k] > least ? at[0][k] : least;
        if (at[1][k] > most * room) most = at[1][k] / room, found = k;
    }
    release(views, 2);
    return good ? PyLong_FromSsize_t(found) : misfit();
}

static PyObject *bounds_rows(PyObject *self, PyObject *args) {
    PyObject *objects[MOST], *pairs;
    Py_buffer views[MOST];
    double *at[MOST], approach;
    Py_ssize_t n[MOST];
    (void)self;
    if (!PyArg_ParseTuple(args, "OOOOO!dOO", objects, objects + 1, objects + 2, objects + 3, &PyList_Type, &pairs,
                          &approach, objects + 4, objects + 5) ||
        !take(objects, 6, views, at, n))
        return NULL;
    const Py_ssize_t joints = n[1] / 6, count = PyList_Size(pairs);
    int good = joints > 0 && n[1] == 6 * joints && n[0] == 6 * count && n[2] == n[3] * joints &&
               n[4] == count * joints && n[5] == count && !views[4].readonly && !views[5].readonly;
    for (Py_ssize_t i = 0; good && i < count; i++) {
        const Py_ssize_t k = PyLong_AsSsize_t(PyList_GetItem(pairs, i));
        good = k >= 0 && k < n[3];
        if (!good) break;
        gradient(at[0] + 6 * i, at[1], at[2] + k * joints, at[4] + i * joints, joints);
        at[5][i] = at[3][k] > 0.0 ? -at[3][k] * approach : 0.0;
    }
    release(views, 6);
    if (good) Py_RETURN_NONE;
    return PyErr_Occurred() ? NULL : misfit();
}

static PyObject *bounds_binding(PyObject *self, PyObject *args) {
    PyObject *objects[MOST];
    Py_buffer views[MOST];
    double *at[MOST];
    Py_ssize_t n[MOST];
    (void)self;
    if (!PyArg_ParseTuple(args, "OOO", objects, objects + 1, objects + 2) || !take(objects, 3, views, at, n)) return NULL;
    const int good = n[0] == n[1] * n[2];
    PyObject *found = good ? PyList_New(0) : misfit();
    for (Py_ssize_t i = 0; found && i < n[1]; i++) {
        double fastest = 0.0;
        for (Py_ssize_t j = 0; j < n[2]; j++) fastest += fabs(at[0][i * n[2] + j]) * at[2][j];
        if (!(fastest > -at[1][i])) continue;
        PyObject *number = PyLong_FromSsize_t(i);
        if (!number || PyList_Append(found, number) < 0) Py_CLEAR(found);
        Py_XDECREF(number);
    }
    release(views, 3);
    return found;
}

static PyMethodDef methods[] = {
    {"follow", bounds_follow, METH_VARARGS, "follow(rooms, reach, positions, x, continuous)"},
    {"certify", bounds_certify, METH_VARARGS, "certify(rooms, reach, spare, shares, out): False if a room is none"},
    {"near", bounds_near, METH_VARARGS, "near(rooms, watch): pairs whose room is below their watch"},
    {"soonest", bounds_soonest, METH_VARARGS, "soonest(rooms, most, least): the pair whose room may be used up first"},
    {"rows", bounds_rows, METH_VARARGS, "rows(ends, J, kinds, rooms, pairs, approach, G, lower)"},
    {"binding", bounds_binding, METH_VARARGS, "binding(G, lower, fastest): rows that joint speeds can break"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_bounds", "Lower bounds of distances.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__bounds(void) { return PyModule_Create(&module); }
