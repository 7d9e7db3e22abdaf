/* The core as a Python module. A Core works on three blocks of memory that it shares with Python: arrays whose buffers it
 * holds as long as it lives, and it is told where each field begins. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>

#include "core.h"
#include "guards.h"
#include "minding.h"
#include "pointer.h"
#include "spatial.h"

#define FIELDS_IN_ALL (CONFIG_FIELDS + STATE_FIELDS + WORK_FIELDS)

/* The best arithmetic that this processor can do. */
static const Arithmetic *best(void) {
#ifdef HAS_AVX2_ARITHMETIC
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return &arithmetic_avx2;
#endif
    return &arithmetic_plain;
}

typedef struct {
    PyObject_HEAD
    Core core;
    const Arithmetic *can; /* NULL before it is built */
    Py_buffer memory[3];   /* the blocks; released with the Core */
    double *own_pose;      /* where own_path leaves its numbers, 12 */
    PyObject *own_path, *bound_knot, *evasion;     /* callables; NULL for none */
    PyObject *clear, *rows_of, *tightened; /* likewise: no row can bind; put rows into the memory, and tighten them */
    PyObject *survey_here, *survey_ahead;          /* likewise: a piece of work on distances, once a step each */
    PyObject *path_buffer, *pose_buffer;           /* arrays whose memory is in use */
    PyObject *step_type, *context, *statuses;      /* what a step is made of */
    double *minding, *places;                      /* relaxation of forces, also the core's; places of the tools */
    PyObject *minding_buffer, *places_buffer;      /* their arrays; NULL for none */
    PyObject *tell;                                /* called with a step that forces have something to say about */
    unsigned long busy;                            /* the thread that works here; 0 for none */
    unsigned long stepper;                         /* the thread that made the last step; 0 for none */
    int entered;                                   /* how often it has entered and not left */
    int handed;                                    /* a step is left open: the next entry is the same one's */
    PyObject *interrupt[3];                        /* type, value and traceback, until the call ends; or NULL */
#ifdef GUARDED
    Guards guards;
#endif
} CoreObject;

static CoreObject *owner_of(Core *c) { return (CoreObject *)(void *)((char *)c - offsetof(CoreObject, core)); }

#ifdef GUARDED
static Guards *guards_of(const Core *c) { return &owner_of((Core *)(uintptr_t)c)->guards; }
#endif

/* -- memory ---------------------------------------------------------------------------------------------------------- */

/* The numbers of a contiguous float64 buffer; NULL and an exception if it is something else or has another length. */
static double *numbers(PyObject *object, Py_ssize_t count, int writable, Py_buffer *view) {
    if (PyObject_GetBuffer(object, view, PyBUF_FORMAT | PyBUF_C_CONTIGUOUS | (writable ? PyBUF_WRITABLE : 0)) < 0)
        return NULL;
    if (view->itemsize == 8 && view->format && view->format[0] == 'd' && !view->format[1] &&
        (count < 0 || view->len == 8 * count))
        return view->buf;
    PyBuffer_Release(view);
    PyErr_SetString(PyExc_ValueError, "expected a contiguous array of float64 of the right length");
    return NULL;
}

/* Hold the blocks and find every field in them; 0 if they do not fit. */
static int place_fields(CoreObject *self, PyObject *blocks, PyObject *places) {
    static const int fields[3] = {CONFIG_FIELDS, STATE_FIELDS, WORK_FIELDS};
    double **field = (double **)(void *)&self->core; /* FIELDS stand first */
    if (PyTuple_Size(blocks) != 3 || PyTuple_Size(places) != FIELDS_IN_ALL) return 0;
    for (int block = 0, i = 0; block < 3; block++) {
        double *begins = numbers(PyTuple_GetItem(blocks, block), -1, 1, self->memory + block);
        if (!begins) return 0;
        const Py_ssize_t length = self->memory[block].len / 8;
        for (int n = 0; n < fields[block]; n++, i++) {
            Py_ssize_t begin, end;
            PyObject *place = PyTuple_GetItem(places, i);
            if (!PyTuple_Check(place) || !PyArg_ParseTuple(place, "nn", &begin, &end)) return 0;
            if (begin < 0 || end < begin || end + GAP > length) return 0;
            field[i] = begins + begin;
#ifdef GUARDED
            self->guards.end[i] = begins + end;
#endif
        }
    }
    return 1;
}

/* Whether the arms' joints lie inside the vectors, and there are as many unknowns as they make. */
static int consistent(Core *c) {
    int unknowns = TWIST_AND_SHARES;
    for (int k = 0; k < c->arms; k++) {
        const double start = c->arm_start[k], size = c->arm_size[k];
        if (!(start >= 0 && size >= 6 && size <= MOST_JOINTS && start + size <= c->joints)) return 0;
        unknowns += (int)size - 6;
    }
    for (int j = 0; j < c->joints; j++) {
        const double at = c->q_index[j], width = c->continuous[j] != 0.0 ? 2 : 1;
        if (!(at >= 0 && at + width <= c->nq)) return 0;
        c->accelerates = c->accelerates || isfinite(c->acceleration[j]);
    }
    c->redundant = unknowns > TWIST_AND_SHARES;
    return unknowns == c->unknowns;
}

static int core_init(PyObject *object, PyObject *args, PyObject *kwargs) {
    CoreObject *self = (CoreObject *)object;
    Core *c = &self->core;
    PyObject *blocks, *places;
    int plain = 0;
    (void)kwargs;
    if (self->can || self->memory[0].obj) {
        PyErr_SetString(PyExc_ValueError, "a Core is built once");
        return -1;
    }
    if (!PyArg_ParseTuple(args, "O!O!(iiiiii)|p", &PyTuple_Type, &blocks, &PyTuple_Type, &places, &c->arms, &c->joints,
                          &c->nq, &c->unknowns, &c->past, &c->rows, &plain))
        return -1;
    if (c->arms < 1 || c->joints < 6 || c->nq < c->joints || c->past < 1 || c->rows < 0 ||
        !place_fields(self, blocks, places) || !consistent(c)) {
        if (!PyErr_Occurred()) PyErr_SetString(PyExc_ValueError, "the memory does not fit together");
        return -1;
    }
    static const double nowhere[3] = {1.0, 0.0, 0.0};
    c->duration = 1.0, c->path_numbers = nowhere;
    self->can = guarded(c, plain ? &arithmetic_plain : best());
    return 0;
}

/* Functions of the loop that owns the Core make a cycle, which the collector has to see. */
static int core_traverse(PyObject *object, visitproc visit, void *arg) {
    CoreObject *self = (CoreObject *)object;
    Py_VISIT(Py_TYPE(object));
    Py_VISIT(self->own_path);
    Py_VISIT(self->bound_knot);
    Py_VISIT(self->evasion);
    Py_VISIT(self->clear);
    Py_VISIT(self->rows_of);
    Py_VISIT(self->tightened);
    Py_VISIT(self->survey_here);
    Py_VISIT(self->survey_ahead);
    Py_VISIT(self->path_buffer);
    Py_VISIT(self->pose_buffer);
    Py_VISIT(self->step_type);
    Py_VISIT(self->context);
    Py_VISIT(self->statuses);
    Py_VISIT(self->minding_buffer);
    Py_VISIT(self->places_buffer);
    Py_VISIT(self->tell);
    return 0;
}

static int core_clear(PyObject *object) {
    CoreObject *self = (CoreObject *)object;
    self->core.own_path = NULL;
    self->core.bound_knot = NULL;
    self->core.evade = NULL;
    self->core.survey_ahead = NULL;
    Py_CLEAR(self->own_path);
    Py_CLEAR(self->bound_knot);
    Py_CLEAR(self->evasion);
    Py_CLEAR(self->clear);
    Py_CLEAR(self->rows_of);
    Py_CLEAR(self->tightened);
    Py_CLEAR(self->survey_here);
    Py_CLEAR(self->survey_ahead);
    Py_CLEAR(self->step_type);
    Py_CLEAR(self->context);
    Py_CLEAR(self->statuses);
    Py_CLEAR(self->tell);
    return 0;
}

static void core_dealloc(PyObject *object) {
    CoreObject *self = (CoreObject *)object;
    PyTypeObject *type = Py_TYPE(object);
    PyObject_GC_UnTrack(object);
    core_clear(object);
    Py_CLEAR(self->path_buffer);
    Py_CLEAR(self->pose_buffer);
    Py_CLEAR(self->minding_buffer);
    Py_CLEAR(self->places_buffer);
    for (int block = 0; block < 3; block++)
        if (self->memory[block].obj) PyBuffer_Release(self->memory + block);
    freefunc release = POINTER(freefunc, PyType_GetSlot(type, Py_tp_free));
    release(object);
    Py_DECREF(type);
}

static CoreObject *built(PyObject *object) {
    CoreObject *self = (CoreObject *)object;
    if (self->can) return self;
    PyErr_SetString(PyExc_RuntimeError, "this Core was not built");
    return NULL;
}

/* -- calls into Python ----------------------------------------------------------------------------------------------- */

/* Call a Python function that says whether it succeeded; an exception counts as failure. After an interrupt nothing more
 * is asked, and the call that the core is in raises it. */
static int ask(CoreObject *self, PyObject *function, PyObject *arguments) {
    PyObject *found = arguments && !self->interrupt[0] ? PyObject_CallObject(function, arguments) : NULL;
    Py_XDECREF(arguments);
    const int good = found && PyObject_IsTrue(found) == 1;
    Py_XDECREF(found);
    if (PyErr_Occurred()) {
        if (PyErr_ExceptionMatches(PyExc_Exception))
            PyErr_WriteUnraisable(function);
        else
            PyErr_Fetch(self->interrupt, self->interrupt + 1, self->interrupt + 2);
    }
    return good;
}

/* Whether a call has to end with an interrupt, which is raised. */
static int interrupted(CoreObject *self) {
    if (!self->interrupt[0]) return 0;
    PyErr_Restore(self->interrupt[0], self->interrupt[1], self->interrupt[2]);
    self->interrupt[0] = self->interrupt[1] = self->interrupt[2] = NULL;
    return 1;
}

static int ask_path(Core *c, double clock, int twist, double *out) {
    CoreObject *self = owner_of(c);
    guard(c, 0);
    const int good = self->own_path && ask(self, self->own_path, Py_BuildValue("(di)", clock, twist));
    guard(c, 1);
    if (!good) return 0;
    memcpy(out, self->own_pose, (size_t)(twist ? 6 : 12) * sizeof(double));
    return 1;
}

static int ask_knot(Core *c, int slot) {
    guard(c, 0);
    const int good = ask(owner_of(c), owner_of(c)->bound_knot, Py_BuildValue("(i)", slot));
    guard(c, 1);
    return good;
}

/* set_path(numbers, own, pose, duration, looks_ahead, users): own(clock, twist) writes into pose. */
static PyObject *core_set_path(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    PyObject *path, *own, *pose;
    double duration, *found, *where = NULL;
    int looks_ahead, users;
    Py_buffer view;
    if (!self || !PyArg_ParseTuple(args, "OOOdpp", &path, &own, &pose, &duration, &looks_ahead, &users)) return NULL;
    if (!(found = numbers(path, -1, 0, &view))) return NULL;
    const Py_ssize_t count = view.len / 8;
    PyBuffer_Release(&view); /* the arrays stay where they are while they are held here */
    const int asks = own != Py_None;
    if (!(count >= 3 && found[1] >= 0 && found[1] < 1e6 && found[2] >= (asks ? 0 : 1) && found[2] < 1e6 &&
          count >= 3 + (Py_ssize_t)found[1] + SEGMENT * (Py_ssize_t)found[2] +
                       (Py_ssize_t)self->core.options[ELBOWS] * (1 + 2 * self->core.joints))) {
        PyErr_SetString(PyExc_ValueError, "the numbers are no path");
        return NULL;
    }
    if (asks) {
        if (!(where = numbers(pose, 12, 1, &view))) return NULL;
        PyBuffer_Release(&view);
    }
    Py_INCREF(path);
    Py_INCREF(own);
    Py_INCREF(pose);
    Py_XDECREF(self->path_buffer);
    Py_XDECREF(self->own_path);
    Py_XDECREF(self->pose_buffer);
    self->path_buffer = path, self->own_path = own, self->pose_buffer = pose, self->own_pose = where;
    self->core.own_path = asks ? ask_path : NULL;
    self->core.path_numbers = found;
    self->core.duration = duration, self->core.looks_ahead = looks_ahead, self->core.users_path = users;
    Py_RETURN_NONE;
}

static PyObject *core_bind_knots(PyObject *object, PyObject *function) {
    CoreObject *self = built(object);
    if (!self) return NULL;
    PyObject *old = self->bound_knot;
    self->bound_knot = function == Py_None ? NULL : function;
    Py_XINCREF(self->bound_knot);
    Py_XDECREF(old);
    self->core.bound_knot = self->bound_knot ? ask_knot : NULL;
    Py_RETURN_NONE;
}

static int ask_evasion(Core *c) {
    guard(c, 0);
    const int good = ask(owner_of(c), owner_of(c)->evasion, PyTuple_New(0));
    guard(c, 1);
    return good;
}

static PyObject *core_bind_evasion(PyObject *object, PyObject *function) {
    CoreObject *self = built(object);
    if (!self) return NULL;
    PyObject *old = self->evasion;
    self->evasion = function == Py_None ? NULL : function;
    Py_XINCREF(self->evasion);
    Py_XDECREF(old);
    self->core.evade = self->evasion ? ask_evasion : NULL;
    Py_RETURN_NONE;
}

static PyObject *core_bind_rows(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    PyObject *clear, *rows, *tightened;
    if (!self || !PyArg_ParseTuple(args, "OOO", &clear, &rows, &tightened)) return NULL;
    Py_INCREF(clear);
    Py_INCREF(rows);
    Py_INCREF(tightened);
    Py_XDECREF(self->clear);
    Py_XDECREF(self->rows_of);
    Py_XDECREF(self->tightened);
    self->clear = clear, self->rows_of = rows, self->tightened = tightened;
    Py_RETURN_NONE;
}

static int survey_ahead(Core *c) {
    guard(c, 0);
    const int some = ask(owner_of(c), owner_of(c)->survey_ahead, PyTuple_New(0));
    guard(c, 1);
    return some;
}

static PyObject *core_bind_surveys(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    PyObject *here, *ahead;
    if (!self || !PyArg_ParseTuple(args, "OO", &here, &ahead)) return NULL;
    Py_INCREF(here);
    Py_INCREF(ahead);
    Py_XDECREF(self->survey_here);
    Py_XDECREF(self->survey_ahead);
    self->survey_here = here, self->survey_ahead = ahead, self->core.survey_ahead = survey_ahead;
    Py_RETURN_NONE;
}

static PyObject *core_make_steps(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    PyObject *type, *context, *statuses;
    if (!self || !PyArg_ParseTuple(args, "O!OO!", &PyType_Type, &type, &context, &PyTuple_Type, &statuses)) return NULL;
    if (PyTuple_Size(statuses) < N_STATUSES) {
        PyErr_SetString(PyExc_ValueError, "a status is missing");
        return NULL;
    }
    Py_INCREF(type);
    Py_INCREF(context);
    Py_INCREF(statuses);
    Py_XDECREF(self->step_type);
    Py_XDECREF(self->context);
    Py_XDECREF(self->statuses);
    self->step_type = type, self->context = context, self->statuses = statuses;
    Py_RETURN_NONE;
}

/* -- steps ----------------------------------------------------------------------------------------------------------- */

/* What Python hands over in a step: q (NULL for none), dt (NULL for none; a NaN is refused, with its reason). */
typedef struct {
    Py_buffer view;
    double length, *q;
    const double *dt;
} Sample;

/* 0 and an exception if q is no array of the right size. */
static int read_sample(CoreObject *self, PyObject *q, PyObject *dt, Sample *out) {
    out->q = NULL, out->dt = NULL;
    if (dt && dt != Py_None) {
        out->length = PyFloat_AsDouble(dt);
        if (PyErr_Occurred()) PyErr_Clear(), out->length = NAN;
        out->dt = &out->length;
    }
    return !q || q == Py_None || (out->q = numbers(q, self->core.nq, 0, &out->view));
}

/* Observe it, and give it back; 0 and an exception after an interrupt. */
static int take_sample(CoreObject *self, Sample *sample) {
    self->can->observe(&self->core, sample->q, sample->dt);
    if (sample->q) PyBuffer_Release(&sample->view);
    return !interrupted(self);
}

static int take(CoreObject *self, PyObject *q, PyObject *dt) {
    Sample sample;
    return read_sample(self, q, dt, &sample) && take_sample(self, &sample);
}

/* Numbers of the record as bytes. */
static PyObject *record_of(const Core *c) {
    const Py_ssize_t count = N_RECORD + 2 * c->nq + c->joints + 6 + 4 * (Py_ssize_t)c->record[R_BINDINGS];
    return PyBytes_FromStringAndSize((const char *)c->record, 8 * count);
}

/* Names of the attributes that a step is made with. */
static PyObject *record_name, *context_name, *status_name, *rate_name;

/* A step is read-only: its own attributes are set past its class. */
static int set_and_drop(PyObject *object, PyObject *name, PyObject *value) {
    const int good = value && PyObject_GenericSetAttr(object, name, value) == 0;
    Py_XDECREF(value);
    return good;
}

/* A ControlStep from the record. */
static PyObject *make_step(CoreObject *self, int status) {
    if (!self->step_type) return record_of(&self->core);
    PyObject *step = PyType_GenericAlloc((PyTypeObject *)self->step_type, 0);
    if (!step) return NULL;
    PyObject *known = PyTuple_GetItem(self->statuses, status);
    if (set_and_drop(step, record_name, record_of(&self->core)) &&
        PyObject_GenericSetAttr(step, context_name, self->context) == 0 &&
        PyObject_GenericSetAttr(step, status_name, known) == 0 &&
        set_and_drop(step, rate_name, PyFloat_FromDouble(self->core.record[R_RATE])))
        return step;
    Py_DECREF(step);
    return NULL;
}

/* One thread at a time; the one that already works here may enter again. Other threads get a BusyError. */
static int enter(CoreObject *self) {
    const unsigned long me = PyThread_get_thread_ident();
    if (self->busy && self->busy != me) {
        PyObject *errors = PyImport_ImportModule("coopqp.errors");
        PyObject *kind = errors ? PyObject_GetAttrString(errors, "BusyError") : NULL;
        if (kind) PyErr_SetNone(kind);
        Py_XDECREF(kind);
        Py_XDECREF(errors);
        return 0;
    }
    self->busy = me;
    if (self->handed)
        self->handed = 0;
    else
        self->entered++;
    return 1;
}

static void leave(CoreObject *self) {
    if (self->entered > 0) self->entered--;
    if (!self->entered) self->busy = 0;
}

static PyObject *core_hold(PyObject *object, PyObject *unused) {
    (void)unused;
    if (!enter((CoreObject *)object)) return NULL;
    Py_RETURN_NONE;
}

static PyObject *core_release(PyObject *object, PyObject *unused) {
    (void)unused;
    leave((CoreObject *)object);
    Py_RETURN_NONE;
}

static PyObject *core_steps_here(PyObject *object, PyObject *unused) {
    (void)unused;
    ((CoreObject *)object)->stepper = PyThread_get_thread_ident();
    Py_RETURN_NONE;
}

static PyObject *core_steps_elsewhere(PyObject *object, PyObject *unused) {
    const unsigned long stepper = ((CoreObject *)object)->stepper;
    (void)unused;
    return PyBool_FromLong(stepper && stepper != PyThread_get_thread_ident());
}

/* A number that a function answers; -1 where it fails. An exception is left to the definition, which asks again. */
static long number_of(CoreObject *self, PyObject *function, PyObject *argument) {
    PyObject *found = PyObject_CallFunctionObjArgs(function, argument, NULL);
    const long number = found ? PyLong_AsLong(found) : -1;
    Py_XDECREF(found);
    if (!PyErr_Occurred()) return number;
    if (PyErr_ExceptionMatches(PyExc_Exception))
        PyErr_Clear();
    else
        PyErr_Fetch(self->interrupt, self->interrupt + 1, self->interrupt + 2);
    return -1;
}

/* Rows that constraints may give; those that brake all arms together come after them. */
static long most_given(const Core *c) { return c->rows - (1 + c->arms + c->joints); }

/* The outcome with all further rows, tightened if the command breaks their constraints; ASK where the definition
 * has to say. */
static int answer_with_rows(CoreObject *self) {
    Core *c = &self->core;
    const long rows = self->rows_of ? number_of(self, self->rows_of, c->looks_ahead ? Py_False : Py_True) : -1;
    if (rows < 0 || rows > most_given(c)) return ASK;
    c->given_rows = (int)rows;
    int outcome = self->can->answer(c);
    for (int i = 0; rows && i < (int)MOST_TIGHTENINGS && outcome < FILLED; i++) {
        const long tighter = number_of(self, self->tightened, NULL);
        if (tighter < 0) return ASK;
        if (!tighter) break;
        outcome = self->can->answer(c);
    }
    return outcome < FILLED ? outcome : ASK;
}

/* The step for the observed sample. None if the answer is left open: then a call that finishes it has to follow. */
static PyObject *command(CoreObject *self) {
    Core *c = &self->core;
    c->given_rows = 0;
    int outcome = self->can->propose(c);
    int asks = c->options[CERTIFIED] != 0.0 && (outcome >= FILLED || !self->can->quiet(c));
    if (asks && outcome < FILLED && self->clear && !self->interrupt[0])
        asks = number_of(self, self->clear, c->looks_ahead ? Py_False : Py_True) != 1;
    else if (!asks && self->survey_here && !self->interrupt[0])
        number_of(self, self->survey_here, NULL);
    if (asks && !self->interrupt[0]) c->proposal[OUTCOME] = outcome = answer_with_rows(self);
    if (interrupted(self)) return NULL;
    if (outcome < FILLED) return make_step(self, self->can->commit(c));
    self->handed = 1;
    Py_RETURN_NONE;
}

static PyObject *core_step(PyObject *object, PyObject *const *args, Py_ssize_t n) {
    CoreObject *self = built(object);
    if (!self || !enter(self)) return NULL;
    self->stepper = self->busy;
    PyObject *step = take(self, n > 0 ? args[0] : NULL, n > 1 ? args[1] : NULL) ? command(self) : NULL;
    if (!self->handed) leave(self);
    return step;
}

static PyObject *core_observe(PyObject *object, PyObject *const *args, Py_ssize_t n) {
    CoreObject *self = built(object);
    if (!self || !take(self, n > 0 ? args[0] : NULL, n > 1 ? args[1] : NULL)) return NULL;
    Py_RETURN_NONE;
}

static PyObject *core_propose(PyObject *object, PyObject *const *args, Py_ssize_t n) {
    CoreObject *self = built(object);
    if (!self) return NULL;
    const long rows = n > 0 ? PyLong_AsLong(args[0]) : 0, again = n > 1 ? PyObject_IsTrue(args[1]) : 0;
    if (PyErr_Occurred()) return NULL;
    if (rows < 0 || rows > most_given(&self->core)) {
        PyErr_SetString(PyExc_ValueError, "there is no room for so many rows");
        return NULL;
    }
    self->core.given_rows = (int)rows;
    const int outcome = again ? self->can->answer(&self->core) : self->can->propose(&self->core);
    return interrupted(self) ? NULL : PyLong_FromLong(outcome);
}

static PyObject *core_read(PyObject *object, PyObject *cap) {
    CoreObject *self = built(object);
    const double rate = self ? PyFloat_AsDouble(cap) : 0.0;
    if (!self || PyErr_Occurred()) return NULL;
    return PyBool_FromLong(self->can->read(&self->core, rate));
}

static PyObject *core_commit(PyObject *object, PyObject *unused) {
    CoreObject *self = built(object);
    (void)unused;
    return self ? make_step(self, self->can->commit(&self->core)) : NULL;
}

/* Steps without Python in between, to time the core alone; stops where a step is open. Returns how many were done. */
static PyObject *core_advance(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    PyObject *q = NULL;
    Py_ssize_t steps, done = 0;
    Py_buffer view;
    double *measured = NULL;
    if (!self || !PyArg_ParseTuple(args, "n|O", &steps, &q)) return NULL;
    if (q && q != Py_None && !(measured = numbers(q, self->core.nq, 0, &view))) return NULL;
    for (; done < steps; done++) {
        self->can->observe(&self->core, measured, NULL);
        if (self->can->propose(&self->core) >= FILLED || self->interrupt[0]) break;
        if (self->core.options[CERTIFIED] != 0.0 && !self->can->quiet(&self->core)) break;
        self->can->commit(&self->core);
    }
    if (measured) PyBuffer_Release(&view);
    return interrupted(self) ? NULL : PyLong_FromSsize_t(done);
}

static PyObject *core_start(PyObject *object, PyObject *positions) {
    CoreObject *self = built(object);
    Py_buffer view;
    double *x = self ? numbers(positions, self->core.joints, 0, &view) : NULL;
    if (!x) return NULL;
    self->can->start(&self->core, x);
    PyBuffer_Release(&view);
    Py_RETURN_NONE;
}

static PyObject *core_start_path(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    double clock, rate;
    if (!self || !PyArg_ParseTuple(args, "dd", &clock, &rate)) return NULL;
    self->can->start_path(&self->core, clock, rate);
    if (interrupted(self)) return NULL;
    Py_RETURN_NONE;
}

/* go_over(goal, numbers, speed, spin, full): 1 if the way in `numbers` is taken from now on; see core.h. */
static PyObject *core_go_over(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    PyObject *goal, *path;
    double speed, spin, full, *at[2];
    Py_buffer views[2];
    if (!self || !PyArg_ParseTuple(args, "OOddd", &goal, &path, &speed, &spin, &full)) return NULL;
    if (!(at[0] = numbers(goal, 12, 0, views))) return NULL;
    if (!(at[1] = numbers(path, 4 + SEGMENT, 1, views + 1))) {
        PyBuffer_Release(views);
        return NULL;
    }
    const double *present = self->core.path_numbers;
    const int found = self->can->go_over(&self->core, at[0], speed, spin, full, at[1]);
    if (found > 0) { /* the array stays where it is while it is held here */
        Py_INCREF(path);
        Py_XDECREF(self->path_buffer);
        self->path_buffer = path;
    } else {
        self->core.path_numbers = present;
    }
    for (int i = 0; i < 2; i++) PyBuffer_Release(views + i);
    return interrupted(self) ? NULL : PyLong_FromLong(found);
}

/* linearise(positions, about, carried, jacobian): kinematics into the caller's arrays. */
static PyObject *core_linearise(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    PyObject *arrays[4];
    Py_buffer views[4];
    double *x[4];
    if (!self || !PyArg_ParseTuple(args, "OOOO", arrays, arrays + 1, arrays + 2, arrays + 3)) return NULL;
    const Py_ssize_t counts[4] = {self->core.joints, 3, 12 * self->core.arms, 6 * self->core.joints};
    for (int i = 0; i < 4; i++)
        if (!(x[i] = numbers(arrays[i], counts[i], i > 1, views + i))) {
            while (i--) PyBuffer_Release(views + i);
            return NULL;
        }
    self->can->linearise(&self->core, x[0], x[1], x[2], x[3]);
    for (int i = 0; i < 4; i++) PyBuffer_Release(views + i);
    Py_RETURN_NONE;
}

/* The tools have the places (R, p) of their last joints on the object, 12 each, and each has moved by exp of its shift,
 * 6 each, in the object frame: object_R, object_p = place · exp(−shift). 0 if a shift is not finite. */
static int move_grasp(Core *c, const double *places, const double *shift) {
    for (int i = 0; i < 6 * c->arms; i++)
        if (!isfinite(shift[i])) return 0;
    for (int k = 0; k < c->arms; k++) {
        const double *place = places + 12 * k;
        double back[6], R[9], p[3];
        for (int i = 0; i < 6; i++) back[i] = -shift[6 * k + i];
        exp6(back, R, p);
        multiply3(place, R, c->object_R + 9 * k);
        rotate(place, p, c->object_p + 3 * k);
        for (int i = 0; i < 3; i++) c->object_p[3 * k + i] += place[9 + i];
    }
    best()->expect_shift(c, shift);
    return 1;
}

static PyObject *core_shift_grasp(PyObject *object, PyObject *const *args, Py_ssize_t count) {
    CoreObject *self = built(object);
    Py_buffer views[2];
    double *x[2];
    if (!self) return NULL;
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "shift_grasp takes places and shift");
        return NULL;
    }
    for (int i = 0; i < 2; i++)
        if (!(x[i] = numbers(args[i], (i ? 6 : 12) * (Py_ssize_t)self->core.arms, 0, views + i))) {
            if (i) PyBuffer_Release(views);
            return NULL;
        }
    const int good = move_grasp(&self->core, x[0], x[1]);
    PyBuffer_Release(views), PyBuffer_Release(views + 1);
    return PyBool_FromLong(good);
}

#include "minding_module.c"

/* -- least-distance programs by themselves --------------------------------------------------------------------------- */

#define LDP_BUFFERS 8

static PyObject *module_least_distance(PyObject *self, PyObject *args) {
    PyObject *buffers;
    double reach, *at[LDP_BUFFERS];
    Py_ssize_t length[LDP_BUFFERS];
    (void)self;
    if (!PyArg_ParseTuple(args, "O!d", &PyTuple_Type, &buffers, &reach)) return NULL;
    if (PyTuple_Size(buffers) != LDP_BUFFERS) {
        PyErr_Format(PyExc_ValueError, "expected %d buffers", LDP_BUFFERS);
        return NULL;
    }
    for (int i = 0; i < LDP_BUFFERS; i++) {
        unsigned long long address;
        if (!PyArg_ParseTuple(PyTuple_GetItem(buffers, i), "Kn", &address, &length[i])) return NULL;
        at[i] = (double *)(uintptr_t)address;
    }
    const Py_ssize_t m = length[1] / 8, n = length[5] / 8;
    const Py_ssize_t wanted[] = {8 * m * n, 8 * m, 8 * m, 8 * n, 8 * n, 8 * n, 8 * (m + n), 16 * n * (n + 3)};
    int fits = n > 0 && n <= 10000 && m >= 0 && m <= 1000000;
    for (int i = 0; i < LDP_BUFFERS; i++) fits = fits && length[i] == wanted[i];
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "the buffers do not fit together");
        return NULL;
    }
    return PyLong_FromLong(
        best()->least_distance((int)n, (int)m, at[0], at[1], at[2], at[3], at[4], reach, at[5], at[6], at[7]));
}

/* -- module ---------------------------------------------------------------------------------------------------------- */

#define FAST(f) ((PyCFunction)(void (*)(void))(f))

static PyMethodDef core_methods[] = {
    {"step", FAST(core_step), METH_FASTCALL, "step(q, dt): observe, propose, commit; None if the answer is open."},
    {"hold", core_hold, METH_NOARGS, "hold(): this thread works here; BusyError if another one does."},
    {"steps_here", core_steps_here, METH_NOARGS, "steps_here(): this thread steps."},
    {"steps_elsewhere", core_steps_elsewhere, METH_NOARGS, "steps_elsewhere(): another thread made the last step."},
    {"release", core_release, METH_NOARGS, "release(): this thread ends, as often as it began."},
    {"observe", FAST(core_observe), METH_FASTCALL, "observe(q, dt): take one sample."},
    {"propose", FAST(core_propose), METH_FASTCALL,
     "propose(rows, again): find the command with this many further rows; returns an outcome."},
    {"read", core_read, METH_O, "read(cap): take the solution x of the condensed QP; False if it breaks limits."},
    {"commit", core_commit, METH_NOARGS, "commit(): move the state; returns the step."},
    {"advance", core_advance, METH_VARARGS, "advance(steps, q): steps without Python in between."},
    {"start", core_start, METH_O, "start(positions): at rest there."},
    {"start_path", core_start_path, METH_VARARGS, "start_path(clock, rate): along the path from there."},
    {"set_path", core_set_path, METH_VARARGS, "set_path(numbers, function, pose, duration, looks_ahead)."},
    {"go_over", core_go_over, METH_VARARGS, "go_over(goal, numbers, speed, spin, full): to a new target."},
    {"bind_knots", core_bind_knots, METH_O, "bind_knots(function): called with the place of every new knot."},
    {"bind_evasion", core_bind_evasion, METH_O, "bind_evasion(function): may change evading_slope."},
    {"bind_rows", core_bind_rows, METH_VARARGS, "bind_rows(clear, rows, tightened): what step() asks for further rows."},
    {"bind_surveys", core_bind_surveys, METH_VARARGS, "bind_surveys(here, ahead): work that step() spreads."},
    {"make_steps", core_make_steps, METH_VARARGS, "make_steps(type, context, statuses): what step() returns."},
    {"linearise", core_linearise, METH_VARARGS, "linearise(positions, about, carried, jacobian)."},
    {"shift_grasp", FAST(core_shift_grasp), METH_FASTCALL, "shift_grasp(places, shift); False if not finite."},
    {"bind_minding", core_bind_minding, METH_VARARGS, "bind_minding(memory, places, tell): for step_minding."},
    {"step_minding", FAST(core_step_minding), METH_FASTCALL,
     "step_minding(memory, q, dt, wrenches): step; False where Python has to take part first."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot core_slots[] = {
    {Py_tp_doc, "Core(blocks, places, sizes, plain=False): the compiled step over memory that Python owns."},
    {Py_tp_init, POINTER(void *, core_init)},
    {Py_tp_dealloc, POINTER(void *, core_dealloc)},
    {Py_tp_traverse, POINTER(void *, core_traverse)},
    {Py_tp_clear, POINTER(void *, core_clear)},
    {Py_tp_methods, core_methods},
    {Py_tp_new, POINTER(void *, PyType_GenericNew)},
    {0, NULL},
};

static PyType_Spec core_spec = {"coopqp.control.core._native.Core", sizeof(CoreObject), 0,
                               Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, core_slots};

static PyMethodDef module_methods[] = {
    {"least_distance", module_least_distance, METH_VARARGS,
     "least_distance(((address, bytes), ...), reach): of A, low, high, lb, ub, x, y, work; see functions.h."},
    {"relax", FAST(module_relax), METH_FASTCALL, "relax(memory, arms, wrenches, dt); see relax.c."},
    {"allow", FAST(module_allow), METH_FASTCALL, "allow(memory, arms, dt); see allow.c."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_native", "The compiled step.", -1, module_methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__native(void) {
    PyObject *m = PyModule_Create(&module), *type = m ? PyType_FromSpec(&core_spec) : NULL;
    record_name = PyUnicode_InternFromString("_record"), context_name = PyUnicode_InternFromString("_context");
    status_name = PyUnicode_InternFromString("status"), rate_name = PyUnicode_InternFromString("rate");
    if (type && record_name && context_name && status_name && rate_name && PyModule_AddObject(m, "Core", type) == 0 &&
        PyModule_AddIntConstant(m, "GAP", GAP) == 0)
        return m;
    Py_XDECREF(type);
    Py_XDECREF(m);
    return NULL;
}
