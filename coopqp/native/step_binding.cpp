/* The core for Python. A Core works on three blocks of memory that it shares with Python: arrays that it holds as long as
 * it lives, and it is told where each field begins. */

#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include "arrays.h"
#include "core.h"
#include "guards.h"
#include "minding.h"
#include "spatial.h"

/* Objects of Python that a Core holds: callables, empty for none, and what a step is made of. */
enum {
    OWN_PATH, BOUND_KNOT, EVADE, CLEAR, FURTHER_ROWS, TIGHTENED, SURVEY_HERE, SURVEY_AHEAD, /* put numbers into the memory */
    TELL,                                                                    /* of a step that forces say something of */
    STEP_TYPE, CONTEXT, STATUSES,
    OBJECTS
};

struct BoundCore : Core {
    const Arithmetic *can = nullptr;
    Out memory[3];               /* the blocks */
    In path_array;               /* numbers of the path; or of the way to a new target: */
    Out way_array, pose_array;   /* pose: where own_path leaves its numbers, 12 */
    Out minding_array;           /* relaxation of forces, also the core's */
    In places_array;             /* of the tools */
    nb::object minding_given;    /* the object of `minding_array` */
    nb::object objects[OBJECTS];
    unsigned long busy = 0;      /* the thread that works here; 0 for none */
    unsigned long stepper = 0;   /* the thread that made the last step; 0 for none */
    int entered = 0;             /* how often it has entered and not left */
    bool handed = false;         /* a step is left open: the next entry is the same one's */
    std::optional<nb::python_error> interrupt; /* until the call ends */
#ifdef GUARDED
    Guards guards = {};
#endif

    BoundCore() : Core{} {}
};

using Maybe = std::optional<nb::object>; /* None, too */

static BoundCore *loop_of(Core *c) { return static_cast<BoundCore *>(c); }

#ifdef GUARDED
static Guards *guards_of(const Core *c) { return &loop_of(const_cast<Core *>(c))->guards; }
#endif

/* -- memory ---------------------------------------------------------------------------------------------------------- */

using Places = std::vector<std::pair<Py_ssize_t, Py_ssize_t>>;

/* Find every field in the blocks; false if they do not fit. */
static bool place_fields(BoundCore *self, const Places &places) {
    size_t i = 0;
    bool good = places.size() == FIELDS_IN_ALL;
    const auto place = [&](const Out &memory) -> double * {
        if (!good) return nullptr;
        const auto [begin, end] = places[i];
        good = begin >= 0 && end >= begin && end <= memory.size - GAP;
#ifdef GUARDED
        if (good) self->guards.end[i] = memory.data + end;
#endif
        i++;
        return memory.data + begin;
    };
#define PLACE_IN(block, type, name) self->name = reinterpret_cast<type *>(place(self->memory[block]));
#define PLACE_CONFIG(type, name) PLACE_IN(0, type, name)
#define PLACE_STATE(type, name) PLACE_IN(1, type, name)
#define PLACE_WORK(type, name) PLACE_IN(2, type, name)
    CONFIG_FIELDS(PLACE_CONFIG)
    STATE_FIELDS(PLACE_STATE)
    WORK_FIELDS(PLACE_WORK)
    return good;
}

/* Whether the arms' joints lie inside the vectors, and there are as many unknowns as they make. */
static bool consistent(Core *c) {
    int unknowns = TWIST_AND_SHARES;
    for (int k = 0; k < c->arms; k++) {
        const double start = c->arm_start[k], size = c->arm_size[k];
        if (!(start >= 0 && size >= 6 && size <= MOST_JOINTS && start + size <= c->joints)) return false;
        unknowns += (int)size - 6;
    }
    for (int j = 0; j < c->joints; j++) {
        const double at = c->q_index[j], width = c->continuous[j] != 0.0 ? 2 : 1;
        if (!(at >= 0 && at + width <= c->nq)) return false;
        c->accelerates = c->accelerates || isfinite(c->acceleration[j]);
    }
    c->redundant = unknowns > TWIST_AND_SHARES;
    return unknowns == c->unknowns;
}

static void build(BoundCore *self, Out &config, Out &state, Out &work, const Places &places, int arms, int joints, int nq,
                  int unknowns, int past, int rows, bool plain_arithmetic) {
    static const double nowhere[3] = {1.0, 0.0, 0.0};
    new (self) BoundCore();
    self->memory[0] = std::move(config), self->memory[1] = std::move(state), self->memory[2] = std::move(work);
    self->arms = arms, self->joints = joints, self->nq = nq;
    self->unknowns = unknowns, self->past = past, self->rows = rows;
    if (arms < 1 || joints < 6 || nq < joints || past < 1 || rows < 0 || !place_fields(self, places) ||
        !consistent(self)) {
        self->~BoundCore();
        throw nb::value_error("the memory does not fit together");
    }
    self->duration = 1.0, self->path_numbers = nowhere;
    self->can = guarded(self, plain_arithmetic ? &plain::arithmetic : best());
}

/* Functions of the loop that owns the Core make a cycle, which the collector has to see. */
static int traverse(PyObject *object, visitproc visit, void *arg) {
    Py_VISIT(Py_TYPE(object));
    if (!nb::inst_ready(object)) return 0;
    for (nb::object &held : nb::inst_ptr<BoundCore>(object)->objects) Py_VISIT(held.ptr());
    return 0;
}

static int clear(PyObject *object) {
    if (!nb::inst_ready(object)) return 0;
    BoundCore *self = nb::inst_ptr<BoundCore>(object);
    self->own_path = nullptr, self->bound_knot = nullptr, self->evade = nullptr, self->survey_ahead = nullptr;
    for (nb::object &held : self->objects) held.reset();
    return 0;
}

/* -- calls into Python ----------------------------------------------------------------------------------------------- */

/* Call a function of Python for a number, or for yes or no; −1 where it fails, after an interrupt, or without a function.
 * After an interrupt nothing more is asked, and the call that the core is in raises it. What else is raised is dropped
 * where a number is asked for, as the definition asks again; else it is printed. */
template <typename... Args>
static long asked(BoundCore *self, int which, bool yes_or_no, Args... args) {
    const nb::object &function = self->objects[which];
    if (self->interrupt || !function.is_valid()) return -1;
    try {
        const nb::object answer = function(args...);
        const long found = yes_or_no ? PyObject_IsTrue(answer.ptr()) : PyLong_AsLong(answer.ptr());
        if (found == -1 && PyErr_Occurred()) throw nb::python_error();
        return found;
    } catch (nb::python_error &error) {
        if (!error.matches(PyExc_Exception))
            self->interrupt.emplace(error);
        else if (yes_or_no)
            error.discard_as_unraisable(function);
    }
    return -1;
}

/* The same of a function that fills in the memory: whether it succeeded. */
template <typename... Args>
static int filled_in(Core *c, int which, Args... args) {
    guard(c, 0);
    const int good = asked(loop_of(c), which, true, args...) > 0;
    guard(c, 1);
    return good;
}

/* A call has to end with an interrupt. */
static void raise_interrupt(BoundCore *self) {
    if (!self->interrupt) return;
    nb::python_error error(std::move(*self->interrupt));
    self->interrupt.reset();
    throw error;
}

static int ask_path(Core *c, double clock, int twist, double *out) {
    if (!filled_in(c, OWN_PATH, clock, twist)) return 0;
    memcpy(out, loop_of(c)->pose_array.data, (size_t)(twist ? 6 : 12) * sizeof(double));
    return 1;
}

static int ask_knot(Core *c, int slot) { return filled_in(c, BOUND_KNOT, slot); }
static int ask_evasion(Core *c) { return filled_in(c, EVADE); }
static int ask_survey(Core *c) { return filled_in(c, SURVEY_AHEAD); }

/* Hold an object, or none. */
static bool hold_object(BoundCore &self, int which, const Maybe &given) {
    self.objects[which] = given.value_or(nb::object());
    return given.has_value();
}

/* set_path(numbers, own, pose, duration, looks_ahead, users): own(clock, twist) writes into pose. */
static void set_path(BoundCore &self, In &numbers, const Maybe &own, Out &pose, double duration, bool looks_ahead,
                     bool users) {
    const double *found = numbers.data;
    const bool asks = own.has_value();
    check_fit(numbers.size >= 3 && found[1] >= 0 && found[1] < 1e6 && found[2] >= (asks ? 0 : 1) && found[2] < 1e6 &&
                  numbers.size >= 3 + (Py_ssize_t)found[1] + SEGMENT * (Py_ssize_t)found[2] +
                                      (Py_ssize_t)self.options->elbows * (1 + 2 * self.joints),
              "the numbers are no path");
    check_fit(pose.size == 12, "a pose has 12 numbers");
    self.path_array = std::move(numbers), self.pose_array = std::move(pose);
    self.own_path = hold_object(self, OWN_PATH, own) ? ask_path : nullptr;
    self.path_numbers = found;
    self.duration = duration, self.looks_ahead = looks_ahead, self.users_path = users;
}

static void make_steps(BoundCore &self, const nb::type_object &type, const Maybe &context, const nb::tuple &statuses) {
    check_fit(statuses.size() > OFF_PATH, "a status is missing");
    self.objects[STEP_TYPE] = type, self.objects[STATUSES] = statuses;
    self.objects[CONTEXT] = context.value_or(nb::none());
}

/* -- steps ----------------------------------------------------------------------------------------------------------- */

/* One sample: q (or none) and dt, any object: without one it is the nominal one, and what is no number is a NaN, which is
 * refused with its reason. */
static void observe(BoundCore *self, const InOrNone &q, const Maybe &dt) {
    double length = NAN;
    check_fit(!q.data || q.size == self->nq, "expected an array of float64 of the right length");
    if (dt && !nb::try_cast(*dt, length)) length = NAN;
    self->can->observe(self, q.data, dt ? &length : nullptr);
    raise_interrupt(self);
}

/* Names of the attributes that a step is made with. */
static PyObject *record_name, *context_name, *status_name, *rate_name;

/* A step is read-only: its own attributes are set past its class. */
static void set_past_class(nb::handle object, PyObject *name, nb::handle value) {
    if (!value || PyObject_GenericSetAttr(object.ptr(), name, value.ptr()) < 0) throw nb::python_error();
}

/* A ControlStep from the record; its numbers as bytes where there is no such class. */
static nb::object make_step(BoundCore *self, int status) {
    const Py_ssize_t count = (Py_ssize_t)sizeof(Record) / 8 + 2 * self->nq + self->joints + 6 + 4 * (Py_ssize_t)self->record->bindings;
    nb::bytes record((const void *)self->record, (size_t)count * sizeof(double));
    nb::handle type = self->objects[STEP_TYPE];
    if (!type) return record;
    nb::object step = nb::steal(PyType_GenericAlloc((PyTypeObject *)type.ptr(), 0));
    if (!step) throw nb::python_error();
    set_past_class(step, record_name, record);
    set_past_class(step, context_name, self->objects[CONTEXT]);
    set_past_class(step, status_name, PyTuple_GetItem(self->objects[STATUSES].ptr(), status));
    set_past_class(step, rate_name, nb::float_(self->record->rate));
    return step;
}

/* One thread at a time; the one that already works here may enter again. Other threads get a BusyError. */
static void enter(BoundCore *self) {
    const unsigned long me = PyThread_get_thread_ident();
    if (self->busy && self->busy != me) {
        PyErr_SetNone(nb::module_::import_("coopqp.errors").attr("BusyError").ptr());
        throw nb::python_error();
    }
    self->busy = me;
    self->entered += !self->handed;
    self->handed = false;
}

static void leave(BoundCore *self) {
    if (self->entered > 0) self->entered--;
    if (!self->entered) self->busy = 0;
}

/* The thread that steps works here as long as this lives, and on where a step is left open. */
struct Stepping {
    BoundCore *loop;
    explicit Stepping(BoundCore *self) : loop(self) { enter(self), self->stepper = self->busy; }
    ~Stepping() {
        if (!loop->handed) leave(loop);
    }
};

/* Rows that constraints may give; those that brake all arms together come after them. */
static long most_given(const Core *c) { return c->rows - (1 + c->arms + c->joints); }

/* The outcome with all further rows, tightened if the command breaks their constraints; ASK where the definition
 * has to say. */
static int answer_with_rows(BoundCore *self) {
    const long rows = asked(self, FURTHER_ROWS, false, self->looks_ahead == 0);
    if (rows < 0 || rows > most_given(self)) return ASK;
    self->given_rows = (int)rows;
    int outcome = self->can->answer(self);
    for (int i = 0; rows && i < (int)MOST_TIGHTENINGS && outcome < FILLED; i++) {
        const long tighter = asked(self, TIGHTENED, false);
        if (tighter < 0) return ASK;
        if (!tighter) break;
        outcome = self->can->answer(self);
    }
    return outcome < FILLED ? outcome : ASK;
}

/* The step for the observed sample. None if the answer is left open: then a call that finishes it has to follow. */
static nb::object command(BoundCore *self) {
    self->given_rows = 0;
    int outcome = self->can->propose(self);
    bool asks = self->options->certified != 0.0 && (outcome >= FILLED || !self->can->quiet(self));
    if (asks && outcome < FILLED)
        asks = asked(self, CLEAR, false, self->looks_ahead == 0) != 1; /* no row can bind */
    else if (!asks)
        asked(self, SURVEY_HERE, false);
    if (asks && !self->interrupt) self->proposal->outcome = outcome = answer_with_rows(self);
    raise_interrupt(self);
    if (outcome < FILLED) return make_step(self, self->can->commit(self));
    self->handed = true;
    return nb::none();
}

static nb::object step(BoundCore &self, const InOrNone &q, const Maybe &dt) {
    Stepping here(&self);
    observe(&self, q, dt);
    return command(&self);
}

static int propose(BoundCore &self, long rows, bool again) {
    check_fit(rows >= 0 && rows <= most_given(&self), "there is no room for so many rows");
    self.given_rows = (int)rows;
    const int outcome = again ? self.can->answer(&self) : self.can->propose(&self);
    raise_interrupt(&self);
    return outcome;
}

/* Steps without Python in between, to time the core alone; stops where a step is open. Returns how many were done. */
static Py_ssize_t advance(BoundCore &self, Py_ssize_t steps, const InOrNone &q) {
    Py_ssize_t done = 0;
    check_fit(!q.data || q.size == self.nq);
    for (; done < steps; done++) {
        self.can->observe(&self, q.data, nullptr);
        if (self.can->propose(&self) >= FILLED || self.interrupt) break;
        if (self.options->certified != 0.0 && !self.can->quiet(&self)) break;
        self.can->commit(&self);
    }
    raise_interrupt(&self);
    return done;
}

/* go_over(goal, numbers, speed, spin, full): 1 if the way in `numbers` is taken from now on; see core.h. */
static int go_over(BoundCore &self, const In &goal, Out &numbers, double speed, double spin, double full) {
    check_fit(goal.size == 12 && numbers.size == 4 + SEGMENT);
    const double *present = self.path_numbers;
    const int found = self.can->go_over(&self, goal.data, speed, spin, full, numbers.data);
    if (found > 0)
        self.way_array = std::move(numbers);
    else
        self.path_numbers = present;
    raise_interrupt(&self);
    return found;
}

/* linearise(positions, about, carried, jacobian): kinematics into the caller's arrays. */
static void linearise(BoundCore &self, const In &positions, const In &about, Out &carried, Out &jacobian) {
    check_fit(positions.size == self.joints && about.size == 3 && carried.size == 12 * self.arms &&
                  jacobian.size == 6 * self.joints,
              "expected arrays of the right length");
    self.can->linearise(&self, positions.data, about.data, carried.data, jacobian.data);
}

/* The tools have the places (R, p) of their last joints on the object, 12 each, and each has moved by exp of its shift,
 * 6 each, in the object frame: object_R, object_p = place · exp(−shift). False if a shift is not finite. */
static bool move_grasp(Core *c, const double *places, const double *shift) {
    for (int i = 0; i < 6 * c->arms; i++)
        if (!isfinite(shift[i])) return false;
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
    return true;
}

static bool shift_grasp(BoundCore &self, const In &places, const In &shift) {
    check_fit(places.size == 12 * self.arms && shift.size == 6 * self.arms);
    return move_grasp(&self, places.data, shift.data);
}

/* -- steps with wrenches: they are checked and taken, then the step follows ------------------------------------------- */

/* Wrenches (arms, 6), or none. */
static const double *wrenches_of(const InOrNone &given, int arms) {
    check_fit(!given.data || (given.size == 6 * arms && given.length(0) == arms), "expected one wrench per arm");
    return given.data;
}

static void check_minding(const Out &memory, long arms) {
    check_fit(arms >= 1 && arms <= MOST_MINDING, "too many arms");
    check_fit(memory.size == minding_size(arms));
}

/* bind_minding(memory, places, tell): for step_minding; tell(step) puts words into it. */
static void bind_minding(BoundCore &self, nb::object memory, In &places, nb::object tell) {
    Out forces;
    if (!forces.take(memory.ptr())) throw nb::type_error("expected an array of float64");
    check_minding(forces, self.arms);
    check_fit(places.size == 12 * self.arms);
    self.minding_array = std::move(forces), self.places_array = std::move(places);
    self.minding = reinterpret_cast<Minding *>(self.minding_array.data);
    self.minding_given = std::move(memory), self.objects[TELL] = std::move(tell);
}

/* The length of a step for the relaxation of forces: a dt that observe() refuses counts as the nominal one. */
static double length_of(const Core *c, const Maybe &dt) {
    const double nominal = c->options->nominal_dt;
    double length = NAN;
    if (!dt || !nb::try_cast(*dt, length)) return nominal;
    return length >= c->options->dt_low * nominal && length <= c->options->dt_high * nominal ? length : nominal;
}

/* Largest size of n velocities. */
static double fastest(int n, const double *velocity) {
    double most = 0.0;
    for (int i = 0; i < n; i++) most = maximum(most, fabs(velocity[i]));
    return most;
}

/* step_minding(memory, q, dt, wrenches): a step of a controller that minds forces: the grasps move, the object is as fast
 * as forces let it be. False where Python has to take part first, as it does before the arms relax, and where compliances
 * have to be looked at: nothing has changed then. */
static nb::object step_minding(BoundCore &self, nb::handle memory, const InOrNone &q, const Maybe &dt,
                               const InOrNone &wrenches) {
    Stepping here(&self);
    Minding *m = self.minding;
    if (!memory.is(self.minding_given) || !gives_way(m) || m->age >= LOOK_EVERY) return nb::bool_(false);
    const double *felt = wrenches_of(wrenches, self.arms), length = length_of(&self, dt);
    check_fit(!q.data || q.size == self.nq);
    self.can->relax(self.arms, m, felt, length);
    self.can->allow(self.arms, m, length);
    move_grasp(&self, self.places_array.data, minding_of(self.arms, m).shift);
    self.loop->overridden = m->allowed;
    observe(&self, q, dt);
    nb::object step = command(&self);
    if (self.handed) return step;
    m->reference_dt = m->asked_dt, m->asked_dt = self.record->dt;
    memcpy(minding_of(self.arms, m).reference, self.R, 9 * sizeof(double));
    memcpy(minding_of(self.arms, m).reference + 9, self.p, 3 * sizeof(double));
    m->at_end = !(self.record->clock_next > self.record->clock);
    m->last_rate = self.record->rate, m->last_speed = fastest(self.joints, vectors_of(self.record) + self.nq);
    if (m->why != NOTHING_MORE) self.objects[TELL](step);
    return step;
}

/* -- least-distance programs by themselves --------------------------------------------------------------------------- */

/* Arrays of one size of program, for many solutions; see functions.h. */
struct LeastDistance {
    In A, low, high, lb, ub;
    Out x, y, work;

    int solve(double reach) {
        return best()->least_distance((int)x.size, (int)low.size, A.data, low.data, high.data, lb.data, ub.data, reach,
                                      x.data, y.data, work.data);
    }
};

static void build_program(LeastDistance *self, In &A, In &low, In &high, In &lb, In &ub, Out &x, Out &y, Out &work) {
    const Py_ssize_t m = low.size, n = x.size;
    check_fit(n > 0 && n <= 10000 && m <= 1000000 && A.size == m * n && high.size == m && lb.size == n && ub.size == n &&
              y.size == m + n && work.size == 2 * n * (n + 3));
    new (self) LeastDistance{std::move(A), std::move(low), std::move(high), std::move(lb),
                             std::move(ub), std::move(x),  std::move(y),    std::move(work)};
}

/* -- module ---------------------------------------------------------------------------------------------------------- */

void bind_step(nb::module_ &m) {
    static PyType_Slot slots[] = {
        {Py_tp_traverse, reinterpret_cast<void *>(traverse)}, {Py_tp_clear, reinterpret_cast<void *>(clear)}, {0, nullptr}};
    record_name = PyUnicode_InternFromString("_record"), context_name = PyUnicode_InternFromString("_context");
    status_name = PyUnicode_InternFromString("status"), rate_name = PyUnicode_InternFromString("rate");
    m.attr("GAP") = GAP;
    nb::class_<BoundCore>(m, "Core", nb::type_slots(slots), "The compiled step over memory that Python owns.")
        .def("__init__", build)
        .def("step", step) /* observe, propose, commit; None if the answer is open */
        .def("hold", [](BoundCore &self) { enter(&self); })
        .def("release", [](BoundCore &self) { leave(&self); })
        .def("steps_here", [](BoundCore &self) { self.stepper = PyThread_get_thread_ident(); })
        .def("steps_elsewhere",
             [](BoundCore &self) { return self.stepper && self.stepper != PyThread_get_thread_ident(); })
        .def("observe", [](BoundCore &self, const InOrNone &q, const Maybe &dt) { observe(&self, q, dt); })
        .def("propose", propose)
        .def("read", [](BoundCore &self, double cap) { return self.can->read(&self, cap) != 0; })
        .def("commit", [](BoundCore &self) { return make_step(&self, self.can->commit(&self)); })
        .def("advance", advance)
        .def("start",
             [](BoundCore &self, const In &positions) {
                 check_fit(positions.size == self.joints);
                 self.can->start(&self, positions.data);
             })
        .def("start_path",
             [](BoundCore &self, double clock, double rate) {
                 self.can->start_path(&self, clock, rate);
                 raise_interrupt(&self);
             })
        .def("set_path", set_path)
        .def("go_over", go_over)
        .def("bind_knots",
             [](BoundCore &self, const Maybe &f) { self.bound_knot = hold_object(self, BOUND_KNOT, f) ? ask_knot : nullptr; })
        .def("bind_evasion",
             [](BoundCore &self, const Maybe &f) { self.evade = hold_object(self, EVADE, f) ? ask_evasion : nullptr; })
        .def("bind_rows",
             [](BoundCore &self, const nb::object &clear, const nb::object &rows, const nb::object &tightened) {
                 hold_object(self, CLEAR, clear);
                 hold_object(self, FURTHER_ROWS, rows), hold_object(self, TIGHTENED, tightened);
             })
        .def("bind_surveys",
             [](BoundCore &self, const nb::object &here, const nb::object &ahead) {
                 hold_object(self, SURVEY_HERE, here), hold_object(self, SURVEY_AHEAD, ahead);
                 self.survey_ahead = ask_survey;
             })
        .def("make_steps", make_steps)
        .def("linearise", linearise)
        .def("shift_grasp", shift_grasp)
        .def("bind_minding", bind_minding)
        .def("step_minding", step_minding);
    nb::class_<LeastDistance>(m, "LeastDistance", "A least-distance program over memory that Python owns.")
        .def("__init__", build_program)
        .def("solve", &LeastDistance::solve);
    m.def("relax", [](Out &memory, long arms, const InOrNone &wrenches, double dt) {
        check_minding(memory, arms);
        return (int)best()->relax((int)arms, reinterpret_cast<Minding *>(memory.data), wrenches_of(wrenches, (int)arms), dt);
    });
    m.def("allow", [](Out &memory, long arms, double dt) {
        check_minding(memory, arms);
        best()->allow((int)arms, reinterpret_cast<Minding *>(memory.data), dt);
    });
}
