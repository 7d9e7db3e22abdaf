/* The compiled step as a Python module: arrays in and arrays out.
 *
 * A Kernel is told the addresses and lengths of a Workspace's arrays (contiguous, 8-byte items: compiled.py checks and
 * keeps them alive), a Border those of BorderArrays; their methods work on them. */

#define PY_SSIZE_T_CLEAN
#ifndef Py_LIMITED_API
#define Py_LIMITED_API 0x030A0000
#endif
#include <Python.h>
#include <math.h>

#include "arithmetic.h"

/* CPython passes functions as void *, which ISO C forbids and every platform with dynamic libraries allows. */
#if defined(__GNUC__)
#define POINTER(type, address) (__extension__(type)(address))
#else
#define POINTER(type, address) ((type)(address))
#endif

/* The best of the arithmetics that this processor can do. */
static const Arithmetic *best(void) {
#ifdef HAS_AVX2_ARITHMETIC
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return &arithmetic_avx2;
#endif
    return &arithmetic_plain;
}

typedef struct {
    PyObject_HEAD
    Kernel kernel;
    const Arithmetic *can; /* NULL before it is built */
} KernelObject;

typedef struct {
    PyObject_HEAD
    Border border;
    const Arithmetic *can;
} BorderObject;

/* Addresses and lengths from a tuple of pairs; 0 and an exception if they are not as many as expected. */
static int read_views(PyObject *buffers, View *view, int count) {
    if (PyTuple_Size(buffers) != count) {
        PyErr_Format(PyExc_ValueError, "expected %d buffers", count);
        return 0;
    }
    for (int i = 0; i < count; i++) {
        unsigned long long address;
        if (!PyArg_ParseTuple(PyTuple_GetItem(buffers, i), "Kn", &address, &view[i].len)) return 0;
        view[i].buf = (void *)(uintptr_t)address;
    }
    return 1;
}

static int kernel_init(PyObject *self, PyObject *args, PyObject *kwargs) {
    KernelObject *object = (KernelObject *)self;
    Kernel *k = &object->kernel;
    PyObject *buffers;
    int plain = 0;
    (void)kwargs;
    if (!PyArg_ParseTuple(args, "O!|p", &PyTuple_Type, &buffers, &plain)) return -1;
    if (object->can) {
        PyErr_SetString(PyExc_ValueError, "a Kernel is built once");
        return -1;
    }
    if (!read_views(buffers, k->view, B_COUNT)) return -1;
    Py_ssize_t n = k->view[B_STARTS].len / 8, nv = k->view[B_VELOCITY].len / 8;
    k->arms = (int)n;
    k->joints = (int)nv;
    k->unknowns = (int)(k->view[B_UNIT].len / 8);
    static const int per_joint[] = {B_SCALE, B_LOW, B_HIGH, B_MAXSPEED, B_ACCELERATION, B_LOWER, B_UPPER, B_POSITIONS,
                                    B_VPREV, B_NULL_ALONG, B_NULL_OFFSET, B_ALONG_VELOCITY, B_MIDPOINT,
                                    B_PER_ACCELERATION, B_BASE, B_NORMS, B_ROW_LOWER, B_ROW_UPPER, B_RECOVERY,
                                    B_OUTSIDE};
    static const int per_arm[] = {B_SHARES, B_ERRORS, B_GRASP, B_OFFSETS, B_PREDICTED};
    int fits = k->view[B_JACOBIAN].len == 48 * nv && k->view[B_Y].len == 128 * n && k->view[B_JOINTS].len == 8 * n &&
               k->view[B_SIZES].len == 8 * n && k->view[B_SCALARS].len == 8 * N_SCALARS && k->view[B_LINE].len == 168 &&
               k->view[B_RESULT].len == 32 &&
               k->view[B_R].len == 72 && k->view[B_P].len == 24 && k->view[B_ALONG].len == 48 &&
               k->view[B_PATH].len == 48 && k->view[B_MEASURED].len == 48 && k->view[B_COMMON].len == 48;
    for (size_t i = 0; i < sizeof per_joint / sizeof *per_joint; i++) fits = fits && k->view[per_joint[i]].len == 8 * nv;
    for (size_t i = 0; i < sizeof per_arm / sizeof *per_arm; i++) fits = fits && k->view[per_arm[i]].len == 48 * n;
    int unknowns = TWIST_AND_SHARES;
    for (int a = 0; fits && a < k->arms; a++) {
        int64_t size = L(k, B_SIZES)[a], start = L(k, B_STARTS)[a], joint = L(k, B_JOINTS)[a];
        fits = size >= 6 && size <= MAX_JOINTS && start >= 0 && start + size <= nv && joint >= 0 &&
               (joint + 1) * 96 <= k->view[B_PLACEMENTS].len;
        k->redundant = k->redundant || size > 6;
        unknowns += (int)size - 6;
    }
    fits = fits && k->unknowns == unknowns && k->view[B_COLUMNS].len == 8 * nv * unknowns &&
           k->view[B_ROWS].len == 8 * nv * unknowns;
    for (int j = 0; fits && j < k->joints; j++) k->accelerates = k->accelerates || isfinite(D(k, B_ACCELERATION)[j]);
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "the buffers do not fit together");
        return -1;
    }
    object->can = plain ? &arithmetic_plain : best();
    return 0;
}

static void object_dealloc(PyObject *self) {
    PyTypeObject *type = Py_TYPE(self);
    freefunc release = POINTER(freefunc, PyType_GetSlot(type, Py_tp_free));
    release(self);
    Py_DECREF(type);
}

/* A number; 0 and an exception if it is none, or the object was not built. */
static int number(const Arithmetic *can, PyObject *arg, double *out) {
    if (!can) {
        PyErr_SetString(PyExc_RuntimeError, "this object was not built");
        return 0;
    }
    *out = PyFloat_AsDouble(arg);
    return !(*out == -1.0 && PyErr_Occurred());
}

/* The arguments cap, clock, span. */
static int numbers(const Arithmetic *can, PyObject *const *args, Py_ssize_t n, double *out) {
    if (n != 3) {
        PyErr_SetString(PyExc_TypeError, "expected cap, clock, span");
        return 0;
    }
    return number(can, args[0], out) && number(can, args[1], out + 1) && number(can, args[2], out + 2);
}

static PyObject *kernel_observe(PyObject *self, PyObject *arg) {
    KernelObject *object = (KernelObject *)self;
    double clock;
    return number(object->can, arg, &clock) ? PyBool_FromLong(object->can->observe(&object->kernel, clock)) : NULL;
}

static PyObject *kernel_step(PyObject *self, PyObject *const *args, Py_ssize_t n) {
    KernelObject *object = (KernelObject *)self;
    double x[3];
    if (!numbers(object->can, args, n, x)) return NULL;
    return PyLong_FromLong(object->can->step(&object->kernel, x[0], x[1], x[2]));
}

static PyObject *kernel_rows(PyObject *self, PyObject *const *args, Py_ssize_t n) {
    KernelObject *object = (KernelObject *)self;
    double x[3];
    if (!numbers(object->can, args, n, x)) return NULL;
    return PyLong_FromLong(object->can->rows(&object->kernel, x[0], x[1], x[2]));
}

static int border_init(PyObject *self, PyObject *args, PyObject *kwargs) {
    BorderObject *object = (BorderObject *)self;
    Border *b = &object->border;
    PyObject *buffers;
    int plain = 0;
    (void)kwargs;
    if (!PyArg_ParseTuple(args, "O!p|p", &PyTuple_Type, &buffers, &b->caps_speed, &plain)) return -1;
    if (object->can || !read_views(buffers, b->view, BORDER_COUNT)) return -1;
    b->joints = (int)(b->view[SLOPE].len / 8);
    int fits = b->view[RESULT].len == 72 && b->joints > 0;
    for (int i = 0; i < RESULT; i++) fits = fits && b->view[i].len == b->view[SLOPE].len;
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "the buffers do not fit together");
        return -1;
    }
    object->can = plain ? &arithmetic_plain : best();
    return 0;
}

static PyObject *border_evaluate(PyObject *self, PyObject *arg) {
    BorderObject *object = (BorderObject *)self;
    double span;
    if (!number(object->can, arg, &span)) return NULL;
    object->can->border(&object->border, span);
    Py_INCREF(Py_None);
    return Py_None;
}

/* -- module ---------------------------------------------------------------------------------------------------------- */

static PyMethodDef kernel_methods[] = {
    {"observe", kernel_observe, METH_O, "observe(clock): errors and their common part at the placements."},
    {"step", (PyCFunction)(void (*)(void))kernel_step, METH_FASTCALL,
     "step(cap, clock, span): one fused step over the workspace's buffers; returns an Outcome."},
    {"rows", (PyCFunction)(void (*)(void))kernel_rows, METH_FASTCALL,
     "rows(cap, clock, span): the condensed QP of an open step; returns the joints outside, or -1."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot kernel_slots[] = {
    {Py_tp_doc, "Kernel(((address, bytes), ...), plain=False): the fused step over the arrays of a Workspace."},
    {Py_tp_init, POINTER(void *, kernel_init)},
    {Py_tp_dealloc, POINTER(void *, object_dealloc)},
    {Py_tp_methods, kernel_methods},
    {Py_tp_new, POINTER(void *, PyType_GenericNew)},
    {0, NULL},
};

static PyType_Spec kernel_spec = {"coopqp.control.core._native.Kernel", sizeof(KernelObject), 0, Py_TPFLAGS_DEFAULT, kernel_slots};

static PyMethodDef border_methods[] = {
    {"evaluate", border_evaluate, METH_O, "evaluate(span): curvature and bounds of a cell of that span."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot border_slots[] = {
    {Py_tp_doc, "Border(((address, bytes), ...), caps_speed, plain=False): the bounds of one border of the preview."},
    {Py_tp_init, POINTER(void *, border_init)},
    {Py_tp_dealloc, POINTER(void *, object_dealloc)},
    {Py_tp_methods, border_methods},
    {Py_tp_new, POINTER(void *, PyType_GenericNew)},
    {0, NULL},
};

static PyType_Spec border_spec = {"coopqp.control.core._native.Border", sizeof(BorderObject), 0, Py_TPFLAGS_DEFAULT, border_slots};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_native", "Compiled fused step.", -1, NULL, NULL, NULL, NULL, NULL,
};

/* Add a type to the module; 0 and an exception on failure. */
static int add_type(PyObject *m, const char *name, PyType_Spec *spec) {
    PyObject *type = PyType_FromSpec(spec);
    if (type && PyModule_AddObject(m, name, type) == 0) return 1;
    Py_XDECREF(type);
    return 0;
}

PyMODINIT_FUNC PyInit__native(void) {
    PyObject *m = PyModule_Create(&module);
    if (m && add_type(m, "Kernel", &kernel_spec) && add_type(m, "Border", &border_spec)) return m;
    Py_XDECREF(m);
    return NULL;
}
