/* The core for Python. A Core owns its memory: arrays of Python are views of the fields, which live as long as any of them. */

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <vector>

#include "arrays.h"
#include "core.h"
#include "guards.h"
#include "force_relaxation.h"

/* Objects of Python that a Core holds: callables, empty for none, and what a step is made of. */
enum Held {
    OWN_PATH, BOUND_NODE, STOPPING, EVADE, SOLVE, SURVEY_AHEAD, /* put numbers into the memory */
    CLEAR, FURTHER_ROWS, TIGHTENED, SURVEY_HERE, ATTACH,        /* in the order of the questions */
    ASK_FOR_ROWS, TIGHTEN,                                      /* of constraints that are not in the memory, or failed there */
    AS_MEASURED,                                                /* makes an array of any other object */
    POLL, LOOK,                                                 /* what is due before a step (dt), and at one that is made */
    SAY,                                                        /* puts words into a step that numbers do not describe: those in */
    SAID,
    BEFORE_FORCES, AFTER_FORCES,                                /* where the relaxation of forces needs Python */
    TELL,                                                       /* of a step that forces say something of */
    STEP_TYPE, CONTEXT, STATUS_NAMES,
    OBJECTS
};
static const char *const HELD[OBJECTS] = {
    "own_path", "bound_node", "stopping", "evade", "solve", "survey_ahead", "clear", "further_rows", "tightened", "survey_here",
    "attach", "ask_for_rows", "tighten", "as_measured", "poll", "look", "say", "said", "before_forces", "after_forces", "tell", "step_type", "context",
    "status_names"};

struct Field {
    const char *name;
    size_t begin, size;
};

struct BoundCore : Core {
    const Arithmetic *can = nullptr;
    std::vector<Field> fields;   /* in `memory` */
    std::vector<ArmJoints> all_arms;
    std::vector<Group> all_groups;
    Field state_block = {};      /* all that is the state */
    double *memory = nullptr;
    nb::capsule owner;           /* of the memory: no array holds the core, which would be a cycle that nobody sees */
    InOrNone grasp_array;        /* numbers of the tools' motion on the object */
    In path_array;               /* numbers of the path; or of the way to a new target: */
    InOrNone shift_array;        /* numbers of the path's shifts */
    Out way_array, relaxation_array; /* relaxation of forces, also the core's */
    nb::object objects[OBJECTS];
    unsigned long busy = 0;      /* the thread that works here; 0 for none */
    unsigned long stepper = 0;   /* the thread that made the last step; 0 for none */
    int entered = 0;             /* how often it has entered and not left */
    long steps_until_poll = 1;   /* steps until a look is due */
    bool polled = false;         /* each step is: before it and at it */
    bool by_python = false;      /* the rows of this step are not those of the memory */
    std::optional<nb::python_error> interrupt; /* until the call ends */

    /* The gaps after fields are closed to everybody, or open. */
    void guard(bool closed) const {
        for (size_t i = 0; GAP && i < fields.size(); i++) guard_gap(memory + fields[i].begin + fields[i].size, closed);
    }

    /* A call of the arithmetic, with the gaps closed as long as it lasts. */
    template <auto CALL, typename... Args>
    auto run(Args &&...args) {
        const Guard closed(this);
        return (can->*CALL)(this, std::forward<Args>(args)...);
    }

private:
    struct Guard {
        const BoundCore *core;
        explicit Guard(const BoundCore *one) : core(one) { core->guard(true); }
        ~Guard() { core->guard(false); }
    };
};

using Maybe = std::optional<nb::object>; /* None, too */

static BoundCore *bound(Core *c) { return static_cast<BoundCore *>(c); }

static long ask_constraints(Core *c, Question question);

/* -- memory ---------------------------------------------------------------------------------------------------------- */

/* The memory begins at a multiple of so many numbers in every run: elsewhere vector instructions begin elsewhere, and the
 * last bits of a step are others. */
#define ALIGNED 8

/* Lay out the fields in one piece of memory that is zero, with a gap after each. */
static void lay_out(BoundCore *self) {
    const size_t n = self->arms, nv = self->joints, nq = self->nq, unknowns = self->unknowns, past = self->past;
    const size_t rows = self->rows, x = unknowns + 6 * n + nv + rows, m = 2 * nv + rows; /* unknowns and rows of the largest QP */
    const size_t scratch = x * m + 3 * (m + x) + 2 * x * (x + 3) + 64 * n + 8 * nv;
    size_t end = 0;
#define ADD(type, name, count) self->fields.push_back({#name, end, (count)}), end += self->fields.back().size + GAP;
    CONFIG_FIELDS(ADD)
    const size_t state = end;
    STATE_FIELDS(ADD)
    self->state_block = {"state", state, end - state};
    WORK_FIELDS(ADD)
    void *all = calloc(end + ALIGNED, sizeof(double));
    if (!all) throw std::bad_alloc();
    self->owner = nb::capsule(all, [](void *memory) noexcept { free(memory); });
    const size_t over = reinterpret_cast<uintptr_t>(all) / sizeof(double) % ALIGNED;
    self->memory = static_cast<double *>(all) + (ALIGNED - over) % ALIGNED;
    size_t i = 0;
#define PLACE(type, name, count) place(self->name, self->memory + self->fields[i].begin, self->fields[i].size), i++;
    CONFIG_FIELDS(PLACE) STATE_FIELDS(PLACE) WORK_FIELDS(PLACE)
}

/* A view of each field, of all that is the state, and of single numbers that rows of constraints need. */
static nb::dict fields_of(const BoundCore &self) {
    nb::dict found;
    const auto add = [&](const Field &field) {
        double *begin = self.memory + field.begin;
        found[field.name] = nb::ndarray<nb::numpy, double, nb::ndim<1>>(begin, {field.size}, self.owner);
    };
    for (const Field &field : self.fields) add(field);
    add(self.state_block);
    const auto add_one = [&](const char *name, const double &number) {
        add({name, (size_t)(&number - self.memory), 1});
    };
    add_one("dt", self.proposal->dt), add_one("quiet_slack", self.loop->quiet_slack);
    add_one("quiet_approach", self.loop->quiet_approach), add_one("quiet_ahead_slack", self.loop->quiet_ahead_slack);
    return found;
}

/* A struct of the memory, which it keeps. */
template <typename S>
static nb::object part_of(const BoundCore &self, S *part) {
    return nb::cast(part, nb::rv_policy::reference_internal, self.owner);
}

/* Take the joints that move the tool of arm k, in the order of their numbers, which is that from the base on: whether each does,
 * and how many tools each moves. False if there are none of its own, too many, or some before the shared ones. */
static bool take_arm(BoundCore *c, int k, const double *moves, const std::vector<int> &tools) {
    ArmJoints a = {};
    for (int j = 0; j < c->joints; j++) {
        if (moves[j] == 0.0) continue;
        if (a.shared + a.n == MOST_JOINTS || (tools[(size_t)j] > 1 && a.n > 0)) return false;
        a.joint[a.shared + a.n] = j;
        (tools[(size_t)j] > 1 ? a.shared : a.n)++;
    }
    if (a.n == 0 || (a.shared > 0 && !(c->arm_group[k] >= 0.0))) return false;
    a.start = a.own(0), a.in_line = a.own(a.n - 1) == a.start + a.n - 1;
    c->all_arms.push_back(a);
    return true;
}

/* Take a group of arms that share joints; false if it is too large, or none. */
static bool take_group(BoundCore *c, int number, const double *moves, const std::vector<int> &tools) {
    Group g = {};
    for (int k = 0; k < c->arms; k++) {
        if (c->arm_group[k] != number) continue;
        if (g.arms == MOST_SHARING) return false;
        g.arm[g.arms++] = k;
    }
    g.in_line = g.by_arms = true;
    for (int j = 0; j < c->joints; j++) {
        bool any = false;
        for (int i = 0; i < g.arms; i++) any |= tools[(size_t)j] > 1 && moves[g.arm[i] * c->joints + j] != 0.0;
        if (!any) continue;
        if (g.shared == MOST_GROUP_JOINTS) return false;
        for (int i = 0; i < g.arms; i++) g.in_line &= g.moves[i][g.shared] = moves[g.arm[i] * c->joints + j] != 0.0;
        g.joint[g.shared++] = j;
    }
    g.joints = g.shared;
    for (int i = 0; i < g.arms; i++) {
        const ArmJoints &a = c->all_arms[(size_t)g.arm[i]];
        if (a.shared == 0 || g.joints + a.n > MOST_GROUP_JOINTS) return false;
        for (int j = 0; j < a.n; j++) g.joint[g.joints++] = a.own(j);
        g.by_arms &= a.n >= 6;
    }
    g.by_arms &= g.shared <= MOST_SHARED;
    c->all_groups.push_back(g);
    return g.arms > 1;
}

/* Take which joints move which tools (arms, joints), and the group of each arm, −1 for none; false if they do not lie inside the
 * vectors, or make other unknowns. */
static bool take_joints(BoundCore *c, const In &moves, const In &of_arm, const In &q_index, const In &continuous) {
    int unknowns = TWIST_AND_SHARES;
    double last = -1.0;
    std::vector<int> tools((size_t)c->joints);
    for (int k = 0; k < c->arms; k++) {
        c->arm_group[k] = of_arm.data[k], last = of_arm.data[k] > last ? of_arm.data[k] : last;
        for (int j = 0; j < c->joints; j++) tools[(size_t)j] += moves.data[k * c->joints + j] != 0.0;
    }
    if (!(last < c->arms)) return false;
    for (int k = 0; k < c->arms; k++)
        if (!take_arm(c, k, moves.data + k * c->joints, tools)) return false;
    for (int i = 0; i <= (int)last; i++)
        if (!take_group(c, i, moves.data, tools)) return false;
    c->arm_joints = c->all_arms.data();
    c->groups = (int)c->all_groups.size(), c->group = c->all_groups.data();
    for (const Group &g : c->all_groups) unknowns += std::max(g.joints - 6 * g.arms, 0);
    for (int k = 0; k < c->arms; k++) {
        const ArmJoints &a = c->all_arms[(size_t)k];
        if (!(c->arm_group[k] >= 0.0)) unknowns += std::max(a.n - 6, 0);
        c->few |= a.shared + a.n < 6;
    }
    for (int j = 0; j < c->joints; j++) {
        const double at = c->q_index[j] = q_index.data[j], width = (c->continuous[j] = continuous.data[j]) != 0.0 ? 2 : 1;
        if (!(at >= 0 && at + width <= c->nq)) return false;
    }
    c->redundant = unknowns > TWIST_AND_SHARES;
    return unknowns == c->unknowns;
}

static void build(BoundCore *self, const In &moves, const In &arm_group, const In &q_index, const In &continuous, int nq,
                  int unknowns, int past, int given_rows, bool plain_arithmetic) {
    static const double nowhere[3] = {1.0, 0.0, 0.0};
    const Py_ssize_t arms = arm_group.size, joints = q_index.size, most = 10000;
    const char *unfit = "the sizes do not fit together";
    check_fit(arms >= 1 && arms <= most && joints >= 1 && joints <= most && moves.size == arms * joints && continuous.size == joints &&
                  nq >= joints && nq <= 2 * joints && unknowns >= TWIST_AND_SHARES && unknowns <= TWIST_AND_SHARES + joints &&
                  past >= 1 && past <= 100 * most && given_rows >= 0 && given_rows <= most, unfit);
    new (self) BoundCore();
    self->arms = (int)arms, self->joints = (int)joints, self->nq = nq, self->unknowns = unknowns, self->past = past;
    self->rows = given_rows + 1 + self->arms + self->joints; /* those that brake all arms together come last */
    lay_out(self);
    if (!take_joints(self, moves, arm_group, q_index, continuous)) {
        self->~BoundCore();
        throw nb::value_error(unfit);
    }
    self->duration = 1.0, self->path_numbers = nowhere, self->ask = ask_constraints;
    self->can = plain_arithmetic ? &plain::arithmetic : best();
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
    self->own_path = nullptr, self->bound_node = nullptr, self->evade = nullptr, self->solve = nullptr, self->survey_ahead = nullptr;
    for (nb::object &held : self->objects) held.reset();
    return 0;
}

/* -- calls into Python ----------------------------------------------------------------------------------------------- */

/* What becomes of an exception in a function of Python. */
enum Failing { DROPPED, PRINTED, RAISED };

/* Call a function of Python for a number, or for yes or no where its exceptions are printed; −1 where it fails, after an interrupt,
 * or without a function. After an interrupt nothing more is asked, and the call that the core is in raises it. */
template <typename... Args>
static long asked(BoundCore *self, int which, Failing failing, Args... args) {
    const nb::object &function = self->objects[which];
    if (self->interrupt || !function.is_valid()) return -1;
    try {
        const nb::object answer = function(args...);
        const long found = failing == PRINTED ? PyObject_IsTrue(answer.ptr()) : PyLong_AsLong(answer.ptr());
        if (found == -1 && PyErr_Occurred()) throw nb::python_error();
        return found;
    } catch (nb::python_error &error) {
        if (failing == RAISED || !error.matches(PyExc_Exception))
            self->interrupt.emplace(error);
        else if (failing == PRINTED)
            error.discard_as_unraisable(function);
    }
    return -1;
}

/* The same of a function that fills in the memory: whether it succeeded. */
template <typename... Args>
static int filled_in(Core *c, int which, Args... args) {
    bound(c)->guard(false);
    const int good = asked(bound(c), which, PRINTED, args...) > 0;
    bound(c)->guard(true);
    return good;
}

/* What a grid point in a slot is bound to: bodies in memory know what stops the object there, or leave it to Python. */
static int bound_node(Core *c, int slot) {
    c->node_asked = 1;
    if (!bound(c)->objects[STOPPING]) return filled_in(c, BOUND_NODE, slot);
    bound(c)->guard(false);
    const long label = asked(bound(c), STOPPING, DROPPED, slot, c->nodes[slot].span);
    bound(c)->guard(true);
    if (label == -1) return filled_in(c, BOUND_NODE, slot);
    if (label >= 0) c->nodes[slot].limit.joint = (int)label;
    return label < 0;
}

/* A call has to end with an interrupt. */
static void raise_interrupt(BoundCore *self) {
    if (!self->interrupt) return;
    nb::python_error error(std::move(*self->interrupt));
    self->interrupt.reset();
    throw error;
}

/* How many rows there are: of bodies in the memory; else, and where those fail, of the constraints themselves. */
static long rows_of(BoundCore *self, bool blind) {
    long found = asked(self, FURTHER_ROWS, DROPPED, blind);
    self->by_python = found < 0 || found > most_given(self);
    if (self->by_python) found = asked(self, ASK_FOR_ROWS, RAISED);
    return std::clamp<long>(found, 0, most_given(self));
}

static long ask_constraints(Core *c, Question question) {
    BoundCore *self = bound(c);
    const bool blind = !sees(c);
    const int which = CLEAR + (question - ASK_CLEAR);
    self->guard(false);
    long found = -1;
    switch (question) {
    case ASK_CLEAR: found = asked(self, which, DROPPED, blind, c->node_asked != 0); break;
    case ASK_ROWS: found = rows_of(self, blind); break;
    case ASK_TIGHTER:
        if (!self->by_python) found = asked(self, which, DROPPED);
        if (found < 0) found = asked(self, TIGHTEN, RAISED);
        break;
    case ASK_SURVEY: found = asked(self, which, DROPPED, c->surveyed != 0); break;
    case ASK_CONTACT: found = asked(self, which, RAISED); break;
    }
    self->guard(true);
    return found;
}

/* bind(evade=…, tell=None, …): objects by their names in HELD; None for none. */
static void bind(BoundCore &self, const nb::kwargs &given) {
    for (const auto &[name, object] : given) {
        const char *const *found = HELD;
        while (found < HELD + OBJECTS && strcmp(*found, nb::cast<const char *>(name))) found++;
        check_fit(found < HELD + OBJECTS, "a Core holds nothing of that name");
        self.objects[found - HELD] = object.is_none() ? nb::object() : nb::borrow(object);
    }
    nb::object &type = self.objects[STEP_TYPE], &names = self.objects[STATUS_NAMES];
    const bool good = !type || (PyType_Check(type.ptr()) && nb::isinstance<nb::tuple>(names) && nb::len(names) > OFF_PATH);
    if (!good) type.reset();
    check_fit(good, "a step has a type, and a status of each code");
    const auto where = [&self](Held held, auto call) { return self.objects[held] ? call : nullptr; };
    self.own_path = where(OWN_PATH, +[](Core *c, double clock, int twist) { return filled_in(c, OWN_PATH, clock, twist); });
    self.evade = where(EVADE, +[](Core *c) { return filled_in(c, EVADE); });
    self.solve = where(SOLVE, +[](Core *c, int relax) { return filled_in(c, SOLVE, relax, c->width); });
    self.bound_node = where(BOUND_NODE, bound_node);
    self.asks_rows = self.objects[ASK_FOR_ROWS].is_valid();
    self.survey_ahead = where(SURVEY_AHEAD, +[](Core *c) {
        const int done = filled_in(c, SURVEY_AHEAD);
        return c->surveyed |= done, done;
    });
}

/* set_path(numbers, duration, looks_ahead, users): own_path is bound before where the numbers say little. */
static void set_path(BoundCore &self, In &numbers, double duration, bool looks_ahead, bool users) {
    const double *found = numbers.data;
    check_fit(numbers.size >= 3 && found[1] >= 0 && found[1] < 1e6 && found[2] >= (self.own_path ? 0 : 1) &&
                  found[2] < 1e6 && numbers.size >= 3 + (Py_ssize_t)found[1] + SEGMENT * (Py_ssize_t)found[2] +
                                      (Py_ssize_t)self.options->elbows * (1 + 2 * self.joints),
              "the numbers are no path");
    self.path_array = std::move(numbers);
    self.path_numbers = found;
    self.duration = duration, self.looks_ahead = looks_ahead, self.users_path = users;
}

/* set_shifts(numbers or None): the shifts of the path, see paths.cpp. */
static void set_shifts(BoundCore &self, InOrNone &numbers) {
    check_fit(!numbers.data || numbers.size % SHIFT == 0, "the numbers are no shifts");
    self.shift_array = std::move(numbers);
    self.shifts = self.shift_array.data, self.shift_count = self.shifts ? (int)(self.shift_array.size / SHIFT) : 0;
}

/* Whether ways of joints, see ways.cpp, fill the numbers from a place to their end. */
static bool ends_after_ways(const Core &core, const double *numbers, Py_ssize_t at, Py_ssize_t end) {
    const double ways = numbers[at++];
    if (!(ways >= 0.0 && ways < 1e6)) return false;
    for (int left = (int)ways; left > 0; left--) {
        if (end - at < WAY_HEAD) return false;
        const double *way = numbers + at;
        if (!(way[0] >= 0.0 && way[0] < core.arms && way[6] >= 2.0 && way[6] < 1e6)) return false;
        at += WAY_HEAD + (1 + 2 * (Py_ssize_t)core.arm_joints[(int)way[0]].n) * (Py_ssize_t)way[6];
    }
    return at == end;
}

/* set_grasps(numbers or None): how the tools move on the object along the path, see grasps.cpp. */
static void set_grasps(BoundCore &self, InOrNone &numbers) {
    const double *found = numbers.data;
    Py_ssize_t size = self.arms + 1;
    bool good = !found || numbers.size >= size;
    for (int k = 0; good && found && k < self.arms; k++) {
        good = found[k] >= 0 && found[k] < 1e6;
        if (good) size += GRASP_PIECE * (Py_ssize_t)found[k];
    }
    if (good && found) {
        const double contacts = found[self.arms];
        good = contacts >= 1 && contacts < 1e6;
        if (good) size += (1 + 7 * self.arms) * (Py_ssize_t)contacts;
    }
    if (good && found) good = numbers.size > size && ends_after_ways(self, found, size, numbers.size);
    check_fit(good, "the numbers are no motion of tools");
    self.grasp_array = std::move(numbers);
    self.grasp_numbers = found;
}

/* -- steps ----------------------------------------------------------------------------------------------------------- */

/* Forget what was said of a step. */
static void say_nothing(BoundCore &self) {
    if (PyObject *said = self.objects[SAID].ptr(); said && PyDict_Size(said) > 0) PyDict_Clear(said);
}

/* The length of a step: what is no number is a NaN, which is refused with its reason. */
static double length_of(const Maybe &dt) {
    double length = NAN;
    return dt && nb::try_cast(*dt, length) ? length : NAN;
}

/* One sample: q (or none) and dt, any objects. Without dt the step has its nominal length. */
static void observe(BoundCore &self, const Maybe &q, const Maybe &dt) {
    InOrNone numbers, found;
    if (q && !(numbers.take(q->ptr()) && numbers.is_row(self.nq))) {
        const nb::object &as_measured = self.objects[AS_MEASURED];
        if (!as_measured) throw nb::type_error("expected an array of float64 of the right length");
        const nb::object made = as_measured(*q);
        check_fit(found.take(made.ptr()) && found.is_row(self.nq), "expected an array of float64 of the right length");
        std::swap(numbers, found);
    }
    const double length = length_of(dt);
    self.run<&Arithmetic::observe>(numbers.data, dt ? &length : nullptr);
    raise_interrupt(&self);
}

/* Names of the attributes that a step is made with. */
static PyObject *record_name, *context_name, *status_name, *rate_name;

/* A step is read-only: its own attributes are set past its class. */
static void set_past_class(nb::handle object, PyObject *name, nb::handle value) {
    if (!value || PyObject_GenericSetAttr(object.ptr(), name, value.ptr()) < 0) throw nb::python_error();
}

/* The state and the step's length are numbers; no caller can make them others, but memory that was restored may be. */
static void check_numbers(const BoundCore &self) {
    if (std::isfinite(self.positions.sum() + self.velocity.sum() + self.proposal->dt)) return;
    throw nb::value_error("the controller's memory holds numbers that are none: reset it");
}

/* Move on, and make a ControlStep from the record; its numbers as bytes where there is no such class. */
static nb::object commit(BoundCore &self) {
    check_numbers(self);
    const Status status = self.run<&Arithmetic::commit>();
    const int vectors = 2 * self.nq + self.joints + 6 + 4 * (int)self.record->bindings;
    nb::bytes record(static_cast<const void *>(self.record), sizeof(Record) + (size_t)vectors * sizeof(double));
    nb::handle type = self.objects[STEP_TYPE];
    if (!type) return record;
    nb::object made = nb::steal(PyType_GenericAlloc((PyTypeObject *)type.ptr(), 0));
    if (!made) throw nb::python_error();
    set_past_class(made, record_name, record);
    set_past_class(made, context_name, self.objects[CONTEXT]);
    set_past_class(made, status_name, PyTuple_GetItem(self.objects[STATUS_NAMES].ptr(), status));
    set_past_class(made, rate_name, nb::float_(self.record->rate));
    return made;
}

/* One thread at a time; the one that already works here may enter again. Other threads get a BusyError. */
static void enter(BoundCore &self) {
    const unsigned long me = PyThread_get_thread_ident();
    if (self.busy && self.busy != me) {
        PyErr_SetNone(nb::module_::import_("coopqp.errors").attr("BusyError").ptr());
        throw nb::python_error();
    }
    self.busy = me;
    self.entered++;
}

static void leave(BoundCore &self) {
    if (self.entered > 0) self.entered--;
    if (!self.entered) self.busy = 0;
}

/* The thread that steps works here as long as this lives. */
struct Stepping {
    BoundCore &core;
    explicit Stepping(BoundCore &self) : core(self) { enter(self); }
    ~Stepping() { leave(core); }
};

/* The outcome for the observed sample. */
static Outcome propose(BoundCore &self) {
    const Outcome outcome = self.run<&Arithmetic::propose>();
    raise_interrupt(&self);
    return outcome;
}

/* A step: what is asked for before it, the sample, the command, and words that Python has for it. */
static nb::object make_step(BoundCore &self, const Maybe &q, const Maybe &dt) {
    const bool polled = self.polled;
    if (polled) self.objects[POLL](dt);
    self.stepper = self.busy;
    say_nothing(self);
    observe(self, q, dt);
    propose(self);
    nb::object made = commit(self);
    PyObject *said = self.objects[SAID].ptr();
    if (said && (self.proposal->asked_solver || PyDict_Size(said) > 0)) self.objects[SAY](made);
    const bool due = self.steps_until_poll <= 1;
    if (!due) self.steps_until_poll--;
    if ((polled || due) && self.objects[LOOK]) self.objects[LOOK](made, due);
    return made;
}

/* step(q, dt): observe, propose, commit. Called a thousand times a second, so without the layer that converts arguments. */
static PyObject *step(PyObject *object, PyObject *const *arguments, Py_ssize_t count) noexcept {
    try {
        if (count != 2 || !nb::inst_ready(object)) throw nb::type_error("a step takes q and dt, of a Core that was built");
        const auto given = [&](int i) { return arguments[i] == Py_None ? Maybe() : Maybe(nb::borrow(arguments[i])); };
        BoundCore &self = *nb::inst_ptr<BoundCore>(object);
        Stepping here(self);
        return make_step(self, given(0), given(1)).release().ptr();
    } catch (nb::python_error &error) {
        error.restore();
    } catch (const nb::builtin_exception &error) {
        PyErr_SetString(error.type() == nb::exception_type::type_error ? PyExc_TypeError : PyExc_ValueError, error.what());
    } catch (const std::exception &error) {
        PyErr_SetString(PyExc_ValueError, error.what());
    }
    return nullptr;
}

/* Steps without a ControlStep, to time the core alone. Returns how many were done. */
static Py_ssize_t advance(BoundCore &self, Py_ssize_t steps, const InOrNone &q) {
    Py_ssize_t done = 0;
    check_fit(!q.data || q.is_row(self.nq));
    for (; done < steps && !self.interrupt; done++) {
        self.run<&Arithmetic::observe>(q.data, nullptr);
        self.run<&Arithmetic::propose>();
        self.run<&Arithmetic::commit>();
    }
    raise_interrupt(&self);
    return done;
}

/* The rate that a step from here would keep, and whether no joint without acceleration limit jumps; nothing is committed. */
static nb::tuple try_step(BoundCore &self) {
    const double rate = self.run<&Arithmetic::try_step>();
    say_nothing(self);
    raise_interrupt(&self);
    return nb::make_tuple(rate, !self.run<&Arithmetic::jumps>(static_cast<double *>(self.command)));
}

static void start(BoundCore &self, const In &positions) {
    check_fit(positions.size == self.joints);
    self.run<&Arithmetic::start>(positions.data);
}

static void start_path(BoundCore &self, double clock, double rate) {
    self.run<&Arithmetic::start_path>(clock, rate);
    raise_interrupt(&self);
}

/* retarget(goal, numbers, speed, spin, rate): 1 if the way in `numbers`, which the elbows' follow, is taken from now on; see core.h. */
static int retarget(BoundCore &self, const In &goal, Out &numbers, double speed, double spin, double rate) {
    check_fit(goal.size == 12 && numbers.size == 4 + SEGMENT + (Py_ssize_t)self.options->elbows * (1 + 2 * self.joints));
    const double *present = self.path_numbers;
    const int found = self.run<&Arithmetic::retarget>(goal.data, speed, spin, rate, numbers.data);
    say_nothing(self);
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
    self.run<&Arithmetic::linearise>(positions.data, Vector3(Eigen::Map<const Vector3>(about.data)),
                                     reinterpret_cast<Pose *>(carried.data), jacobian.data);
}

/* Each tool has moved by exp of its shift (6 numbers an arm) from its place, in the object frame. False if one is not finite. */
static bool shift_grasp(BoundCore &self, const In &shift) {
    check_fit(shift.size == 6 * self.arms);
    return self.run<&Arithmetic::move_grasp>(shift.data) != 0;
}

/* -- steps with wrenches: they are checked and taken, then the step follows ------------------------------------------- */

/* Wrenches (arms, 6), or none. */
static const double *wrenches_of(const InOrNone &given, int arms) {
    check_fit(!given.data || (given.size == 6 * arms && given.length(0) == arms), "expected one wrench per arm");
    return given.data;
}

static void check_relaxation(const Out &memory, long arms) {
    check_fit(arms >= 1 && arms <= MOST_RELAXING, "too many arms");
    check_fit(memory.size == relaxation_size(arms));
}

/* bind_forces(memory): for step_with_wrenches. */
static void bind_forces(BoundCore &self, const nb::object &memory) {
    Out forces;
    if (!forces.take(memory.ptr())) throw nb::type_error("expected an array of float64");
    check_relaxation(forces, self.arms);
    self.relaxation_array = std::move(forces);
    self.relaxation = reinterpret_cast<ForceRelaxation *>(self.relaxation_array.data);
}

/* step_with_wrenches(q, dt, wrenches), any objects: a step whose grasps give way to forces, and whose object is as fast as they let
 * it be. Python takes part before the arms relax, where compliances have to be looked at, where arms let go or attach soon, where
 * an operator's change is due, and where wrenches are no array (arms, 6). */
static nb::object step_with_wrenches(BoundCore &self, const Maybe &q, const Maybe &dt, const Maybe &wrenches) {
    Stepping here(self);
    const ForceRelaxation *m = self.relaxation;
    InOrNone felt;
    check_fit(m, "no forces are bound");
    const bool fits = !wrenches || (felt.take(wrenches->ptr()) && felt.size == 6 * self.arms && felt.length(0) == self.arms);
    const bool alone = fits && !self.polled && gives_way(m) && m->age < LOOK_EVERY && self.loop->clock < m->look_at;
    if (alone) self.run<&Arithmetic::relax_before_step>(felt.data, length_of(dt));
    else self.objects[BEFORE_FORCES](q, dt, wrenches);
    nb::object made = make_step(self, q, dt);
    if (!alone) return self.objects[AFTER_FORCES](made), made;
    self.run<&Arithmetic::relax_after_step>();
    if (m->why != NOTHING_MORE) self.objects[TELL](made);
    return made;
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
    static PyMethodDef methods[] = {
        {"step", reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(step)), METH_FASTCALL, "The ControlStep of q and dt."},
        {nullptr, nullptr, 0, nullptr}};
    static PyType_Slot slots[] = {
        {Py_tp_methods, methods}, {Py_tp_traverse, reinterpret_cast<void *>(traverse)}, {Py_tp_clear, reinterpret_cast<void *>(clear)}, {0, nullptr}};
    record_name = PyUnicode_InternFromString("_record"), context_name = PyUnicode_InternFromString("_context");
    status_name = PyUnicode_InternFromString("status"), rate_name = PyUnicode_InternFromString("rate");
    m.attr("GAP") = GAP;
    nb::class_<BoundCore>(m, "Core", nb::type_slots(slots), "The compiled step, and its memory.")
        .def("__init__", build)
        .def("fields", fields_of)
        .def_prop_ro("options", [](BoundCore &self) { return part_of(self, self.options); })
        .def_prop_ro("loop", [](BoundCore &self) { return part_of(self, self.loop); })
        .def_prop_ro("travels", [](BoundCore &self) { return part_of(self, self.travels); })
        .def_prop_ro("proposal", [](BoundCore &self) { return part_of(self, self.proposal); })
        .def("node", [](BoundCore &self, int slot) {
            check_fit(slot >= 0 && slot < MOST_NODES, "there is no such grid point");
            return part_of(self, self.nodes + slot);
        })
        .def("bind", bind)
        .def_rw("steps_until_poll", &BoundCore::steps_until_poll)
        .def_rw("polled", &BoundCore::polled)
        .def("hold", enter)
        .def("release", leave)
        .def("steps_here", [](BoundCore &self) { self.stepper = PyThread_get_thread_ident(); })
        .def("steps_elsewhere",
             [](BoundCore &self) { return self.stepper && self.stepper != PyThread_get_thread_ident(); })
        .def("observe", observe)
        .def("propose", [](BoundCore &self) { return (int)propose(self); })
        .def("commit", commit)
        .def("advance", advance)
        .def("try_step", try_step)
        .def("may_rest", [](BoundCore &self) { return !self.run<&Arithmetic::jumps>((double *)nullptr); })
        .def("start", start)
        .def("start_path", start_path)
        .def("set_path", set_path)
        .def("set_shifts", set_shifts, nb::arg().none())
        .def("set_grasps", set_grasps, nb::arg().none())
        .def("retarget", retarget)
        .def("linearise", linearise)
        .def("shift_grasp", shift_grasp)
        .def("bind_forces", bind_forces)
        .def("step_with_wrenches", step_with_wrenches);
    nb::class_<LeastDistance>(m, "LeastDistance", "A least-distance program over memory that Python owns.")
        .def("__init__", build_program)
        .def("solve", &LeastDistance::solve);
    m.def("relax", [](Out &memory, long arms, const InOrNone &wrenches, double dt) {
        check_relaxation(memory, arms);
        return (int)best()->relax((int)arms, reinterpret_cast<ForceRelaxation *>(memory.data), wrenches_of(wrenches, (int)arms), dt);
    });
    m.def("allow", [](Out &memory, long arms, double dt) {
        check_relaxation(memory, arms);
        best()->allow((int)arms, reinterpret_cast<ForceRelaxation *>(memory.data), dt);
    });
}
