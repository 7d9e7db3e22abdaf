/* Lower bounds of distances as a Python module: functions, which bounds_plain.py says in NumPy, and Nearby. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "bounds.h"
#include "nearby.h"

#define MOST 6

/* -- arrays ---------------------------------------------------------------------------------------------------------- */

/* Hold `count` contiguous float64 arrays; 0 and an exception if they are something else. */
static int take(PyObject **objects, int count, Py_buffer *views, double **at, Py_ssize_t *n) {
    for (int i = 0; i < count; i++) {
        if (PyObject_GetBuffer(objects[i], views + i, PyBUF_FORMAT | PyBUF_C_CONTIGUOUS) == 0) {
            if (views[i].itemsize == 8 && views[i].format && views[i].format[0] == 'd' && !views[i].format[1]) {
                at[i] = static_cast<double *>(views[i].buf), n[i] = views[i].len / 8;
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
    double *at[MOST], least;
    Py_ssize_t n[MOST], found = -1;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOd", objects, objects + 1, &least) || !take(objects, 2, views, at, n)) return NULL;
    const int good = n[1] == n[0] && n[0] > 0;
    if (good) found = soonest(at[0], at[1], least, n[0]);
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
        at[5][i] = least_speed(at[3][k], approach);
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
        if (!breakable(at[0] + i * n[2], at[1][i], at[2], n[2])) continue;
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

int add_bounds(PyObject *module) { return PyModule_AddFunctions(module, methods) == 0 ? add_nearby(module) : -1; }
