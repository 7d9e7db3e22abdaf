/* Steps with wrenches for Python, a part of step_module.cpp: wrenches are checked and taken, then the step follows. */

/* Wrenches, an array (arms, 6) or None; 0 and an exception if they are something else. */
static int read_wrenches(PyObject *object, int arms, double **found, Py_buffer *view) {
    *found = NULL;
    if (object == Py_None) return 1;
    if (!(*found = numbers(object, 6 * (Py_ssize_t)arms, 0, view))) return 0;
    if (view->ndim == 2 && view->shape[0] == arms) return 1;
    PyBuffer_Release(view);
    PyErr_SetString(PyExc_ValueError, "expected one wrench per arm");
    return 0;
}

/* bind_minding(memory, places, tell): for step_minding; tell(step) puts words into it. */
static PyObject *core_bind_minding(PyObject *object, PyObject *args) {
    CoreObject *self = built(object);
    PyObject *memory, *places, *tell;
    double *at[2];
    Py_buffer view;
    if (!self || !PyArg_ParseTuple(args, "OOO", &memory, &places, &tell)) return NULL;
    const Py_ssize_t arms = self->core.arms;
    if (arms > MOST_MINDING) {
        PyErr_SetString(PyExc_ValueError, "too many arms");
        return NULL;
    }
    for (int i = 0; i < 2; i++) { /* the arrays stay where they are while they are held here */
        if (!(at[i] = numbers(i ? places : memory, i ? 12 * arms : minding_size(arms), !i, &view))) return NULL;
        PyBuffer_Release(&view);
    }
    PyObject *old[3] = {self->minding_buffer, self->places_buffer, self->tell};
    Py_INCREF(memory);
    Py_INCREF(places);
    Py_INCREF(tell);
    self->minding = self->core.minding = at[0], self->places = at[1];
    self->minding_buffer = memory, self->places_buffer = places, self->tell = tell;
    for (int i = 0; i < 3; i++) Py_XDECREF(old[i]);
    Py_RETURN_NONE;
}

/* The length of a step for the relaxation of forces: a dt that observe() refuses counts as the nominal one. */
static double length_of(const Core *c, const double *dt) {
    const double nominal = c->options[NOMINAL_DT];
    return dt && *dt >= c->options[DT_LOW] * nominal && *dt <= c->options[DT_HIGH] * nominal ? *dt : nominal;
}

/* Largest size of n velocities. */
static double fastest(int n, const double *velocity) {
    double most = 0.0;
    for (int i = 0; i < n; i++) most = maximum(most, fabs(velocity[i]));
    return most;
}

/* Mind the wrenches, then step: the grasps move, the object is as fast as forces let it be. */
static PyObject *mind_and_step(CoreObject *self, const double *wrenches, double dt, Sample *sample) {
    Core *c = &self->core;
    double *m = self->minding;
    self->can->relax(c->arms, m, wrenches, dt);
    self->can->allow(c->arms, m, dt);
    move_grasp(c, self->places, minding_of(c->arms, m).shift);
    c->loop[OVERRIDDEN] = m[ALLOWED];
    PyObject *step = take_sample(self, sample) ? command(self) : NULL;
    if (!step || self->handed) return step;
    m[REFERENCE_DT] = m[ASKED_DT], m[ASKED_DT] = c->record[R_DT];
    memcpy(minding_of(c->arms, m).reference, c->R, 9 * sizeof(double));
    memcpy(minding_of(c->arms, m).reference + 9, c->p, 3 * sizeof(double));
    m[AT_END] = !(c->record[R_CLOCK_NEXT] > c->record[R_CLOCK]);
    m[LAST_RATE] = c->record[R_RATE], m[LAST_SPEED] = fastest(c->joints, c->record + N_RECORD + c->nq);
    if (m[WHY] == NOTHING_MORE) return step;
    PyObject *told = PyObject_CallFunctionObjArgs(self->tell, step, NULL);
    Py_DECREF(told ? told : step);
    return told ? step : NULL;
}

/* step_minding(memory, q, dt, wrenches): a step of a controller that minds forces. False where Python has to take part
 * first, as it does before the arms relax, and where compliances have to be looked at: nothing has changed then. */
static PyObject *core_step_minding(PyObject *object, PyObject *const *args, Py_ssize_t n) {
    CoreObject *self = built(object);
    if (!self) return NULL;
    if (n != 4) {
        PyErr_SetString(PyExc_TypeError, "step_minding takes memory, q, dt, wrenches");
        return NULL;
    }
    if (!enter(self)) return NULL;
    self->stepper = self->busy;
    PyObject *step = NULL;
    double *wrenches;
    Py_buffer view;
    Sample sample;
    if (args[0] != self->minding_buffer || !gives_way(self->minding) || self->minding[AGE] >= LOOK_EVERY) {
        step = Py_NewRef(Py_False);
    } else if (read_wrenches(args[3], self->core.arms, &wrenches, &view)) {
        if (read_sample(self, args[1], args[2], &sample))
            step = mind_and_step(self, wrenches, length_of(&self->core, sample.dt), &sample);
        if (wrenches) PyBuffer_Release(&view);
    }
    if (!self->handed) leave(self);
    return step;
}

/* relax(memory, arms, wrenches, dt) and allow(memory, arms, dt): see relax.cpp and allow.cpp. */
static double *minding_memory(PyObject *const *args, Py_ssize_t count, Py_ssize_t wanted, int *arms, Py_buffer *view) {
    if (count != wanted) {
        PyErr_SetString(PyExc_TypeError, "relax takes memory, arms, wrenches, dt; allow takes no wrenches");
        return NULL;
    }
    const long given = PyLong_AsLong(args[1]);
    if (PyErr_Occurred()) return NULL;
    if (given < 1 || given > MOST_MINDING) {
        PyErr_SetString(PyExc_ValueError, "too many arms");
        return NULL;
    }
    *arms = (int)given;
    return numbers(args[0], minding_size(given), 1, view);
}

static PyObject *module_relax(PyObject *self, PyObject *const *args, Py_ssize_t count) {
    Py_buffer memory, view;
    double *wrenches;
    int arms, heard = MISSED;
    (void)self;
    double *m = minding_memory(args, count, 4, &arms, &memory);
    if (!m) return NULL;
    const double dt = PyFloat_AsDouble(args[3]);
    const int good = !PyErr_Occurred() && read_wrenches(args[2], arms, &wrenches, &view);
    if (good) {
        heard = best()->relax(arms, m, wrenches, dt);
        if (wrenches) PyBuffer_Release(&view);
    }
    PyBuffer_Release(&memory);
    return good ? PyLong_FromLong(heard) : NULL;
}

static PyObject *module_allow(PyObject *self, PyObject *const *args, Py_ssize_t count) {
    Py_buffer memory;
    int arms;
    (void)self;
    double *m = minding_memory(args, count, 3, &arms, &memory);
    if (!m) return NULL;
    const double dt = PyFloat_AsDouble(args[2]);
    const int good = !PyErr_Occurred();
    if (good) best()->allow(arms, m, dt);
    PyBuffer_Release(&memory);
    if (!good) return NULL;
    Py_RETURN_NONE;
}
