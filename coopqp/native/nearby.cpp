/* Rows of a compiled step beside bodies that stand: the NumPy forms are Clearance.rows_by_label and
 * Clearance.tightened. coal is asked for distances, Pinocchio for placements; a step that is not near asks neither. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "bounds.h"
#include "nearby.h"
#include "pointer.h"
#include "survey.h"

/* Joints this close to their placed positions need no new placement [rad or m]: a step's end is the next one's start. */
#define SAME_PLACE 1e-14
/* Nearest points beyond this are none [m]. */
#define FARTHEST 1e9

/* Arrays, in the order in which Python gives them. */
enum {
    /* of the scene: pairs P, joints nv, numbers of a configuration nq */
    ROOMS, REACH, AT, EPOCH, MARGINS, MOST, FASTEST, KINDS, CONTINUOUS, ARM, SPEEDS, Q_INDEX, Q, JACOBIAN, COUNTS,
    /* of the step: rows m */
    POSITIONS, COMMAND, DT, G, LOWER, UPPER, SOFT, OWNER, CENTRE, WEIGHTS, SLACK, APPROACH,
    /* of knots ahead: numbers, positions, slopes and curvatures of each place */
    KNOTS, KNOT_AT, KNOT_SLOPE, KNOT_CURVATURE,
    ARRAYS
};
/* Numbers, likewise. */
enum {
    BLIND_APPROACH, WATCH, BLIND_WATCH, SAMPLE, STANDS, MOST_PAIRS, KNOT_SIZE, KNOT_SPAN, BENT, SPARE, EVADES, RANGE,
    LEAST_ROOM, DEEPEST, MOST_ASKED,
    NUMBERS
};

/* Work that is spread: none, distances are asked, all is done. */
enum { IDLE, ASKING, DONE };

/* Distances asked in a step ahead of need; the share of a certificate that is used when the next is begun; pairs are
 * asked ahead of a knot this far beyond the motion to it; so many where a command is shown to be clear. Where less than NEEDED of the certificate of what is far is left
 * the survey goes first. */
#define ASKED_EARLY 2
#define ASKED_TO_LAST 2
#define ASKED_FOR_KNOT 3
#define USED 0.5
#define NEEDED 0.25
#define WIDER 1.3

#define PLACING 2 /* functions that place the shapes */

typedef struct {
    PyObject_HEAD
    Py_buffer views[ARRAYS];
    double *at[ARRAYS], number[NUMBERS];
    Py_ssize_t pairs, joints, nq, rows;
    PyObject *owner;                              /* owns the memory that coal writes */
    PyObject *place[PLACING], *placed[PLACING];   /* functions, and their arguments */
    PyObject *ask, *questions, *answers, *points; /* function, arguments of each pair, results, functions */
    const double **normals;                       /* of each pair, in coal's memory */
    double *d, *watch, *x, *next;                 /* distances, watches, joints as placed and at the end */
    Survey survey;
    double epoch;                                 /* of the rooms: another one if they were put anew */
    double *coming;                               /* motion of the joints to the next knot, as the last one had it */
    int job;                                      /* for the next certificate, or knot */
    Py_ssize_t asked;                             /* of this job */
    double watch_of[2];                           /* approach and range of the watches */
    uint64_t *known, stamp;                       /* distances with the present stamp are of this placement */
    int lost;                                     /* the placement of the shapes is unknown */
    int built;                                    /* the object is complete */
    Py_ssize_t *near, *which, binding;            /* near pairs, pairs of the rows, number of rows */
} Nearby;

/* -- asking ---------------------------------------------------------------------------------------------------------- */

static int call(PyObject *function, PyObject *arguments) {
    PyObject *found = PyObject_CallObject(function, arguments);
    Py_XDECREF(found);
    return found != NULL;
}

/* Put the shapes where they are at positions x; 0 and an exception if that fails. */
static int place(Nearby *s, const double *x) {
    double away = s->lost ? INFINITY : 0.0;
    for (Py_ssize_t j = 0; j < s->joints; j++) away = fmax(away, fabs(x[j] - s->x[j]));
    if (away <= SAME_PLACE) return 1;
    for (Py_ssize_t j = 0; j < s->joints; j++) {
        double *q = s->at[Q] + (Py_ssize_t)s->at[Q_INDEX][j];
        q[0] = x[j];
        if (s->at[CONTINUOUS][j] != 0.0) q[0] = cos(x[j]), q[1] = sin(x[j]);
    }
    memcpy(s->x, x, sizeof(double) * (size_t)s->joints);
    s->stamp++, s->lost = 1;
    for (int i = 0; i < PLACING; i++)
        if (!call(s->place[i], s->placed[i])) return 0;
    s->lost = 0;
    return 1;
}

/* Distance of a pair where the shapes are placed, asked once; NAN and an exception if that fails. */
static double distance(Nearby *s, Py_ssize_t k) {
    if (s->known[k] == s->stamp) return s->d[k];
    if (!call(s->ask, PyList_GetItem(s->questions, k))) return NAN;
    PyObject *found = PyObject_GetAttrString(PyList_GetItem(s->answers, k), "min_distance");
    const double d = found ? PyFloat_AsDouble(found) : NAN;
    Py_XDECREF(found);
    if (PyErr_Occurred()) return NAN;
    s->d[k] = d > s->number[DEEPEST] ? d : s->number[DEEPEST];
    s->known[k] = s->stamp;
    return s->d[k];
}

static int ask_room(Nearby *s, Py_ssize_t k) {
    const double d = distance(s, k);
    if (PyErr_Occurred()) return 0;
    s->at[ROOMS][k] = d - s->at[MARGINS][k];
    return 1;
}

/* Nearest point of the second body of a pair that was asked. */
static int nearest_point(Nearby *s, Py_ssize_t k, double *p) {
    PyObject *found = PyObject_CallObject(PyList_GetItem(s->points, k), NULL);
    Py_buffer view;
    if (!found) return 0;
    const int good = PyObject_GetBuffer(found, &view, PyBUF_C_CONTIGUOUS) == 0;
    if (good && view.len == 3 * sizeof(double)) memcpy(p, view.buf, 3 * sizeof(double));
    if (good && view.len != 3 * sizeof(double)) PyErr_SetString(PyExc_ValueError, "a point has three numbers");
    if (good) PyBuffer_Release(&view);
    Py_DECREF(found);
    return !PyErr_Occurred();
}

static Nearby *as_built(PyObject *object) {
    Nearby *s = (Nearby *)object;
    if (s->built) return s;
    PyErr_SetString(PyExc_RuntimeError, "this Nearby was not built");
    return NULL;
}

/* -- rows ------------------------------------------------------------------------------------------------------------ */

/* Pairs are asked within this of their margin: nothing else can reach it at full speed. */
static void set_watches(Nearby *s, double approach, double range) {
    if (s->watch_of[0] == approach && s->watch_of[1] == range) return;
    double most = 0.0;
    s->watch_of[0] = approach, s->watch_of[1] = range;
    for (Py_ssize_t k = 0; k < s->pairs; k++) {
        const double way = s->at[FASTEST][k] / approach;
        s->watch[k] = way < range ? way : range;
        most = s->watch[k] > most ? s->watch[k] : most;
    }
    if (!(most > s->survey.range)) return;
    s->survey.range = most;
    survey_anew(&s->survey, s->at[POSITIONS]);
}

/* Go on from rooms that were put anew. */
static void notice_start(Nearby *s) {
    if (s->epoch == s->at[EPOCH][0]) return;
    s->epoch = s->at[EPOCH][0];
    start_survey(&s->survey);
}

/* Pairs within their watch, asked, in their order: how many; -1 and an exception if that fails, or -2 if they are too
 * many. */
static Py_ssize_t find_near(Nearby *s) {
    const double *rooms = s->at[ROOMS];
    Py_ssize_t count = 0;
    for (Py_ssize_t i = 0; i < s->survey.closes; i++) {
        const Py_ssize_t k = s->survey.close[i];
        if (!(rooms[k] < s->watch[k])) continue;
        if (!ask_room(s, k)) return -1;
        if (!(rooms[k] < s->watch[k])) continue;
        Py_ssize_t n = count++;
        for (; n > 0 && s->near[n - 1] > k; n--) s->near[n] = s->near[n - 1];
        s->near[n] = k;
    }
    return count > (Py_ssize_t)s->number[MOST_PAIRS] || count > s->rows ? -2 : count;
}

/* Whether a pair's room is its distance where the shapes are placed. */
static int is_asked(const Nearby *s, Py_ssize_t k) {
    return s->known[k] == s->stamp && s->at[ROOMS][k] == s->d[k] - s->at[MARGINS][k];
}

/* The close pair whose room may be used up first; -1 of none. */
static Py_ssize_t soonest_close(const Nearby *s) {
    double share = -1.0;
    Py_ssize_t found = -1;
    for (Py_ssize_t i = 0; i < s->survey.closes; i++) {
        const Py_ssize_t k = s->survey.close[i];
        const double beside = s->at[ROOMS][k] - s->survey.spare, least = s->number[LEAST_ROOM];
        const double room = beside > least ? beside : least;
        if (s->at[MOST][k] > share * room) share = s->at[MOST][k] / room, found = k;
    }
    return found;
}

/* Ask for close pairs, a few in a step, until the distance of the one that may use up its room first is known. */
static int sharpen(Nearby *s, Py_ssize_t asked) {
    for (; asked < (Py_ssize_t)s->number[MOST_ASKED]; asked++) {
        const Py_ssize_t k = soonest_close(s);
        if (k < 0 || is_asked(s, k)) return 1;
        if (!ask_room(s, k)) return 0;
    }
    return 1;
}

/* Say about which positions nothing binds, as far as distances are known. */
static void put_certificate(Nearby *s) {
    memcpy(s->at[CENTRE], s->at[AT], sizeof(double) * (size_t)s->joints);
    s->at[SLACK][0] = certify_all(&s->survey, s->at[WEIGHTS]) ? 1.0 : -1.0;
}

/* Rows of the pairs that are near, those that joints at full speed cannot break left out. */
static int put_rows(Nearby *s, Py_ssize_t count, double approach) {
    const Py_ssize_t nv = s->joints;
    Py_ssize_t m = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        const Py_ssize_t k = s->near[i];
        double ends[6], *G_row = s->at[G] + m * nv;
        memcpy(ends, s->normals[k], 3 * sizeof(double));
        if (!nearest_point(s, k, ends + 3)) return 0;
        for (int e = 0; e < 6; e++) /* of an overlap whose depth coal did not find */
            if (!(fabs(ends[e]) < FARTHEST)) memset(ends, 0, sizeof ends);
        gradient(ends, s->at[JACOBIAN], s->at[KINDS] + k * nv, G_row, nv);
        s->at[LOWER][m] = least_speed(s->at[ROOMS][k], approach);
        if (!breakable(G_row, s->at[LOWER][m], s->at[SPEEDS], nv)) continue;
        s->at[UPPER][m] = INFINITY, s->at[SOFT][m] = 1.0, s->at[OWNER][m] = (double)k;
        s->which[m++] = k;
    }
    s->binding = m;
    return 1;
}

/* rows(blind): put the rows of this step, and where none binds, into its memory; how many. */
static PyObject *nearby_rows(PyObject *object, PyObject *blind_given) {
    Nearby *s = as_built(object);
    const int blind = s ? PyObject_IsTrue(blind_given) : -1;
    if (blind < 0) return NULL;
    const double dt = s->at[DT][0], own = s->number[BLIND_APPROACH];
    const double approach = blind && own < 1.0 / dt ? own : 1.0 / dt;
    s->binding = 0;
    notice_start(s);
    s->job = IDLE;
    set_watches(s, approach, s->number[blind ? BLIND_WATCH : WATCH]);
    survey_now(&s->survey, s->at[POSITIONS]);
    follow_close(&s->survey, s->at[POSITIONS]);
    if (!place(s, s->at[POSITIONS])) return NULL;
    const Py_ssize_t count = find_near(s);
    if (count == -2) PyErr_SetString(PyExc_OverflowError, "more pairs are near than a step has rows for");
    if (count < 0 || !sharpen(s, count) || !put_rows(s, count, approach)) return NULL;
    put_certificate(s);
    s->at[APPROACH][0] = blind ? own : INFINITY;
    s->at[COUNTS][0] += 1.0, s->at[COUNTS][1] = (double)s->binding; /* what fails is counted in Python */
    return PyLong_FromSsize_t(s->binding);
}

/* Whether a way of the joints leaves every pair outside its margin: 1 if it does, 0 if not; -1 and an exception. */
static int way_is_clear(Nearby *s, const double *x, const double *way) {
    const Survey *survey = &s->survey;
    int asked = 0;
    if (!(left_at(&s->survey, x) > most_of_two(survey, survey->weights, way))) return 0;
    for (Py_ssize_t i = 0; i < survey->closes; i++) {
        const Py_ssize_t k = survey->close[i];
        const double need = taken(survey, k, way);
        if (s->at[ROOMS][k] > need) continue;
        if (is_asked(s, k)) return 0;
        asked++;
        if (!place(s, x) || !ask_room(s, k)) return -1;
        if (!(s->at[ROOMS][k] > need)) return 0;
    }
    for (; asked < ASKED_TO_LAST; asked++) { /* the next certificate lasts the longer */
        const Py_ssize_t k = soonest_close(s);
        if (k < 0 || is_asked(s, k)) break;
        if (!place(s, x) || !ask_room(s, k)) return -1;
    }
    return 1;
}

/* clear(blind): whether no row can bind the command in memory, without asking for all that is near. */
static PyObject *nearby_clear(PyObject *object, PyObject *blind_given) {
    Nearby *s = as_built(object);
    const int blind = s ? PyObject_IsTrue(blind_given) : -1;
    if (blind < 0) return NULL;
    const double dt = s->at[DT][0], own = s->number[BLIND_APPROACH], *x = s->at[POSITIONS];
    const double approach = blind && own < 1.0 / dt ? own : 1.0 / dt;
    notice_start(s);
    set_watches(s, approach, s->number[blind ? BLIND_WATCH : WATCH]);
    survey_now(&s->survey, x);
    follow_close(&s->survey, x);
    for (Py_ssize_t j = 0; j < s->joints; j++) s->next[j] = fabs(s->at[COMMAND][j]) / approach;
    s->job = IDLE;
    const int clear = way_is_clear(s, x, s->next);
    if (clear < 0) return NULL;
    if (clear) {
        s->binding = 0;
        put_certificate(s);
        s->at[APPROACH][0] = blind ? own : INFINITY;
        s->at[COUNTS][0] += 1.0, s->at[COUNTS][1] = 0.0;
    }
    return PyBool_FromLong(clear);
}

/* tightened(): raise lower bounds where the command leads closer than rows say; whether it does. */
static PyObject *nearby_tightened(PyObject *object, PyObject *unused) {
    Nearby *s = as_built(object);
    int any = 0, placed = 0;
    (void)unused;
    if (!s) return NULL;
    const double dt = s->at[DT][0], *v = s->at[COMMAND];
    for (Py_ssize_t i = 0; i < s->binding; i++) {
        const Py_ssize_t k = s->which[i];
        const double room = s->at[ROOMS][k], least = room < 0.0 ? room : 0.0, *G_row = s->at[G] + i * s->joints;
        double speed = 0.0;
        for (Py_ssize_t j = 0; j < s->joints; j++) speed += G_row[j] * v[j];
        if (!(room + dt * speed < least + s->number[SAMPLE])) continue;
        if (!placed) {
            for (Py_ssize_t j = 0; j < s->joints; j++) s->next[j] = s->at[POSITIONS][j] + dt * v[j];
            if (!place(s, s->next)) return NULL;
            placed = 1;
        }
        const double missing = least - (distance(s, k) - s->at[MARGINS][k]);
        if (PyErr_Occurred()) return NULL;
        if (!(missing > 0.1 * s->number[STANDS])) continue;
        s->at[LOWER][i] = (s->at[LOWER][i] > speed ? s->at[LOWER][i] : speed) + missing / dt;
        any = 1;
    }
    return PyBool_FromLong(any);
}

/* -- ahead ----------------------------------------------------------------------------------------------------------- */

/* The share of the certificate in memory that is used at positions x. */
static double used_at(const Nearby *s, const double *x) {
    for (Py_ssize_t j = 0; j < s->joints; j++) s->survey.way[j] = fabs(x[j] - s->at[CENTRE][j]);
    return most_of_two(&s->survey, s->at[WEIGHTS], s->survey.way);
}

/* Ask for some pairs for the next certificate: 1 if there are more to ask for, else 0; -1 and an exception. */
static int ask_for_certificate(Nearby *s) {
    for (int i = 0; i < ASKED_EARLY; i++, s->asked++) {
        const Py_ssize_t k = soonest_close(s);
        if (s->asked >= (Py_ssize_t)s->number[MOST_ASKED] || k < 0 || is_asked(s, k)) return 0;
        if (!ask_room(s, k)) return -1;
    }
    return 1;
}

/* Ask for some pairs that the motion to the next knot may lead inside their margin, likewise. */
static int ask_for_knot(Nearby *s) {
    const Survey *survey = &s->survey;
    int asked = 0;
    for (Py_ssize_t j = 0; j < s->joints; j++) survey->way[j] = WIDER * fabs(s->coming[j]);
    for (Py_ssize_t i = 0; i < survey->closes; i++) {
        const Py_ssize_t k = survey->close[i];
        const double least = taken(survey, k, survey->way);
        if (is_asked(s, k) || !(s->at[ROOMS][k] < (least > s->number[EVADES] ? least : s->number[EVADES]))) continue;
        if (asked++ == (s->pairs > PIECE * PIECES ? ASKED_FOR_KNOT : ASKED_EARLY)) return 1;
        if (!ask_room(s, k)) return -1;
    }
    return 0;
}

/* prepare(): look at all pairs where the joints start, before the first step. */
static PyObject *nearby_prepare(PyObject *object, PyObject *unused) {
    Nearby *s = as_built(object);
    (void)unused;
    if (!s) return NULL;
    notice_start(s);
    s->job = s->number[EVADES] >= 0.0 ? DONE : IDLE, s->lost = 1; /* ahead there is something to do after the next knot */
    if (s->at[DT][0] > 0.0) set_watches(s, 1.0 / s->at[DT][0], s->number[WATCH]);
    survey_anew(&s->survey, s->at[AT]);
    if (!place(s, s->at[AT])) return NULL;
    Py_RETURN_NONE;
}

/* surveys(): a piece of work ahead of need, if there is any; whether there was. First what is far; then distances, where
 * a step's certificate is used up soon, or where the next knot will be. */
static PyObject *nearby_surveys(PyObject *object, PyObject *unused) {
    Nearby *s = as_built(object);
    (void)unused;
    if (!s) return NULL;
    if (s->epoch != s->at[EPOCH][0]) Py_RETURN_FALSE;
    const int ahead = s->number[EVADES] >= 0.0;
    double *x = s->next;
    for (Py_ssize_t j = 0; j < s->joints; j++) x[j] = ahead ? s->at[AT][j] + s->coming[j] : s->at[POSITIONS][j];
    const int soon = !ahead && s->at[SLACK][0] > 0.0 && (s->job == ASKING || used_at(s, x) > USED);
    const int surveyed = !(soon && left_at(&s->survey, x) > NEEDED) && survey_piece(&s->survey, x);
    const int large = s->pairs > PIECE * PIECES; /* a knot does not wait for one after the other */
    if (surveyed && (!ahead || s->job == DONE || !large)) Py_RETURN_TRUE;
    if (s->job == IDLE) {
        if (!ahead && (s->at[SLACK][0] <= 0.0 || used_at(s, x) < USED)) Py_RETURN_FALSE;
        follow_close(&s->survey, x);
        s->job = ASKING, s->asked = 0;
        if (!place(s, x)) return NULL;
        Py_RETURN_TRUE;
    }
    if (s->job == DONE) Py_RETURN_FALSE;
    const int more = ahead ? ask_for_knot(s) : ask_for_certificate(s);
    if (more < 0) return NULL;
    if (more) Py_RETURN_TRUE;
    s->job = ahead ? DONE : IDLE;
    if (!ahead) put_certificate(s);
    Py_RETURN_TRUE;
}

/* Ask for the close pairs that a way of the joints may lead inside their margin, or that are within `spare`: a list of
 * those that it may lead there; NULL and an exception if that fails. */
static PyObject *ask_on_way(Nearby *s, const double *x, const double *way) {
    const Survey *survey = &s->survey;
    PyObject *found = PyList_New(0);
    for (Py_ssize_t i = 0; found && i < survey->closes; i++) {
        const Py_ssize_t k = survey->close[i];
        const double least = taken(survey, k, way), near = least > s->number[EVADES] ? least : s->number[EVADES];
        if (!(s->at[ROOMS][k] < near)) continue;
        int good = place(s, x) && ask_room(s, k);
        if (good && s->at[ROOMS][k] < least) {
            PyObject *number = PyLong_FromSsize_t(k);
            good = number && PyList_Append(found, number) == 0;
            Py_XDECREF(number);
        }
        if (!good) Py_CLEAR(found);
    }
    return found;
}

/* doubtful(place): pairs that may be inside their margin between the knot before and the one at a place; None if that is
 * not known. */
static PyObject *nearby_doubtful(PyObject *object, PyObject *place_given) {
    Nearby *s = as_built(object);
    const Py_ssize_t at = s ? PyLong_AsSsize_t(place_given) : -1, nv = s ? s->joints : 0;
    if (!s || (at == -1 && PyErr_Occurred())) return NULL;
    const Py_ssize_t size = (Py_ssize_t)s->number[KNOT_SIZE];
    if (at < 0 || at >= s->views[KNOT_AT].len / (8 * nv) || at >= s->views[KNOTS].len / (8 * size)) {
        PyErr_SetString(PyExc_IndexError, "there is no such knot");
        return NULL;
    }
    const double *x = s->at[KNOT_AT] + at * nv, *slope = s->at[KNOT_SLOPE] + at * nv;
    const double *curvature = s->at[KNOT_CURVATURE] + at * nv;
    const double span = s->at[KNOTS][at * size + (Py_ssize_t)s->number[KNOT_SPAN]];
    double *way = s->next;
    notice_start(s);
    for (Py_ssize_t j = 0; j < nv; j++) way[j] = s->number[BENT] * fabs((0.5 * span * curvature[j] - slope[j]) * span);
    survey_now(&s->survey, x);
    follow_close(&s->survey, x);
    const double needs = most_of_two(&s->survey, s->survey.weights, way);
    if (left_at(&s->survey, x) < needs) survey_anew(&s->survey, x); /* the way uses up what is left */
    const int known = most_of_two(&s->survey, s->survey.weights, way) <= left_at(&s->survey, x);
    PyObject *doubtful = known ? ask_on_way(s, x, way) : (Py_INCREF(Py_None), Py_None);
    if (!doubtful) return NULL;
    put_certificate(s);
    for (Py_ssize_t j = 0; j < nv; j++) s->coming[j] = slope[j] * span;
    s->job = IDLE;
    return doubtful;
}

/* -- building -------------------------------------------------------------------------------------------------------- */

/* Hold the arrays; 0 and an exception if one is something else. */
static int hold_arrays(Nearby *s, PyObject *arrays) {
    Py_ssize_t n[ARRAYS];
    if (PyTuple_Size(arrays) != ARRAYS) return 0;
    for (int i = 0; i < ARRAYS; i++) {
        Py_buffer *view = s->views + i;
        if (PyObject_GetBuffer(PyTuple_GetItem(arrays, i), view, PyBUF_FORMAT | PyBUF_C_CONTIGUOUS) < 0) return 0;
        if (view->itemsize != 8 || !view->format || view->format[0] != 'd' || view->format[1]) return 0;
        s->at[i] = static_cast<double *>(view->buf), n[i] = view->len / 8;
    }
    const Py_ssize_t pairs = s->pairs = n[ROOMS], nv = s->joints = n[AT], m = s->rows = n[LOWER];
    const int of_pairs[] = {MARGINS, MOST, FASTEST}, of_rows[] = {UPPER, SOFT, OWNER}, of_one[] = {DT, SLACK, APPROACH};
    const int of_knots[] = {KNOT_AT, KNOT_SLOPE, KNOT_CURVATURE};
    const int of_joints[] = {CONTINUOUS, ARM, SPEEDS, Q_INDEX, POSITIONS, COMMAND, CENTRE, WEIGHTS};
    const int written[] = {ROOMS, AT, Q, COUNTS, G, LOWER, UPPER, SOFT, OWNER, CENTRE, WEIGHTS, SLACK, APPROACH};
    const double places = nv > 0 ? (double)(n[KNOT_AT] / nv) : 0.0, size = s->number[KNOT_SIZE];
    int good = nv > 0 && places * size == (double)n[KNOTS] && s->number[KNOT_SPAN] >= 0.0 && s->number[KNOT_SPAN] < size;
    for (int i = 0; i < 3; i++) good = good && (double)n[of_knots[i]] == places * (double)nv;
    good = good && n[REACH] == nv * pairs && n[KINDS] == nv * pairs && n[JACOBIAN] == 6 * nv && n[G] == m * nv &&
               n[COUNTS] == 2 && n[EPOCH] == 1;
    for (int i = 0; i < 3; i++) good = good && n[of_pairs[i]] == pairs && n[of_rows[i]] == m && n[of_one[i]] == 1;
    for (int i = 0; i < 8; i++) good = good && n[of_joints[i]] == nv;
    for (size_t i = 0; i < sizeof written / sizeof *written; i++) good = good && !s->views[written[i]].readonly;
    for (Py_ssize_t j = 0; good && j < nv; j++) {
        const double at = s->at[Q_INDEX][j];
        good = at >= 0.0 && at + (s->at[CONTINUOUS][j] != 0.0 ? 2.0 : 1.0) <= (double)n[Q];
    }
    return good;
}

/* Hold functions and arguments, and find coal's normals. */
static int hold_functions(Nearby *s, PyObject *placing, PyObject *normals) {
    if (PyTuple_Size(placing) != PLACING || PyList_Size(s->questions) != s->pairs || PyList_Size(s->answers) != s->pairs ||
        PyList_Size(s->points) != s->pairs || PyList_Size(normals) != s->pairs)
        return 0;
    for (int i = 0; i < PLACING; i++)
        if (!PyArg_ParseTuple(PyTuple_GetItem(placing, i), "OO!", s->place + i, &PyTuple_Type, s->placed + i)) {
            s->place[i] = s->placed[i] = NULL;
            return 0;
        } else {
            Py_INCREF(s->place[i]), Py_INCREF(s->placed[i]);
        }
    for (Py_ssize_t k = 0; k < s->pairs; k++) {
        Py_buffer view;
        if (PyObject_GetBuffer(PyList_GetItem(normals, k), &view, PyBUF_C_CONTIGUOUS) < 0) return 0;
        s->normals[k] = static_cast<const double *>(view.buf); /* stays there as long as its owner */
        const int three = view.len == 3 * sizeof(double);
        PyBuffer_Release(&view);
        if (!three) return 0;
    }
    return 1;
}

static int nearby_init(PyObject *object, PyObject *args, PyObject *kwargs) {
    Nearby *s = (Nearby *)object;
    PyObject *arrays, *numbers, *placing, *normals;
    (void)kwargs;
    if (s->owner) {
        PyErr_SetString(PyExc_ValueError, "a Nearby is built once");
        return -1;
    }
    if (!PyArg_ParseTuple(args, "O!O!OO!OO!O!O!O!", &PyTuple_Type, &arrays, &PyTuple_Type, &numbers, &s->owner,
                          &PyTuple_Type, &placing, &s->ask, &PyList_Type, &s->questions, &PyList_Type, &s->answers,
                          &PyList_Type, &s->points, &PyList_Type, &normals)) {
        s->owner = s->ask = s->questions = s->answers = s->points = NULL;
        return -1;
    }
    PyObject *given[] = {s->owner, s->ask, s->questions, s->answers, s->points};
    for (size_t i = 0; i < sizeof given / sizeof *given; i++) Py_INCREF(given[i]);
    s->lost = 1;
    int good = PyTuple_Size(numbers) == NUMBERS;
    for (int i = 0; good && i < NUMBERS; i++) s->number[i] = PyFloat_AsDouble(PyTuple_GetItem(numbers, i));
    good = good && !PyErr_Occurred() && hold_arrays(s, arrays);
    if (good) {
        const Py_ssize_t pairs = s->pairs, nv = s->joints;
        const int held = allocate(s->normals, pairs) && allocate(s->known, pairs) && allocate(s->d, pairs) &&
                         allocate(s->watch, pairs) && allocate(s->x, nv) && allocate(s->next, nv) &&
                         allocate(s->coming, nv) && allocate(s->near, pairs) && allocate(s->which, s->rows);
        const int surveyed = build_survey(&s->survey, pairs, nv, s->at[ROOMS], s->at[AT], s->at[REACH], s->at[CONTINUOUS],
                                          s->at[ARM]);
        s->survey.range = s->number[RANGE], s->survey.spare = s->number[SPARE];
        s->epoch = NAN;
        if (!surveyed || !held) {
            PyErr_NoMemory();
            return -1;
        }
        good = hold_functions(s, placing, normals);
    }
    s->built = good;
    if (good) return 0;
    if (!PyErr_Occurred()) PyErr_SetString(PyExc_ValueError, "what it is given does not fit together");
    return -1;
}

static void nearby_dealloc(PyObject *object) {
    Nearby *s = (Nearby *)object;
    PyTypeObject *type = Py_TYPE(object);
    for (int i = 0; i < ARRAYS; i++)
        if (s->views[i].obj) PyBuffer_Release(s->views + i);
    for (int i = 0; i < PLACING; i++) Py_XDECREF(s->place[i]), Py_XDECREF(s->placed[i]);
    void *own[] = {(void *)s->normals, s->known, s->d, s->watch, s->x, s->next, s->near, s->which};
    for (size_t i = 0; i < sizeof own / sizeof *own; i++) free(own[i]);
    free_survey(&s->survey);
    free(s->coming);
    Py_XDECREF(s->ask), Py_XDECREF(s->questions), Py_XDECREF(s->answers), Py_XDECREF(s->points);
    Py_XDECREF(s->owner);
    freefunc release = POINTER(freefunc, PyType_GetSlot(type, Py_tp_free));
    release(object);
    Py_DECREF(type);
}

static PyMethodDef methods[] = {
    {"rows", nearby_rows, METH_O, "rows(blind): put the rows of this step into its memory; how many."},
    {"clear", nearby_clear, METH_O, "clear(blind): whether no row can bind the command in memory."},
    {"tightened", nearby_tightened, METH_NOARGS, "tightened(): raise bounds that the command breaks; whether it does."},
    {"doubtful", nearby_doubtful, METH_O, "doubtful(place): pairs that may be inside their margin on the way to a knot."},
    {"prepare", nearby_prepare, METH_NOARGS, "prepare(): look at all pairs where the joints start."},
    {"surveys", nearby_surveys, METH_NOARGS, "surveys(): a piece of work on what is far; whether there was any."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_doc, const_cast<char *>("Rows of a compiled step beside bodies that stand, over its memory.")},
    {Py_tp_init, POINTER(void *, nearby_init)},
    {Py_tp_dealloc, POINTER(void *, nearby_dealloc)},
    {Py_tp_methods, methods},
    {Py_tp_new, POINTER(void *, PyType_GenericNew)},
    {0, NULL},
};

static PyType_Spec spec = {"coopqp.native._core.Nearby", sizeof(Nearby), 0, Py_TPFLAGS_DEFAULT, slots};

int add_nearby(PyObject *module) {
    PyObject *type = PyType_FromSpec(&spec);
    if (type && PyModule_AddObject(module, "Nearby", type) == 0) return 0;
    Py_XDECREF(type);
    return -1;
}
