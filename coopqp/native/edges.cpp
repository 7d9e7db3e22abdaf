/* See edges.h. */

#include "edges.h"

#include <math.h>
#include <string.h>

#include <algorithm>
#include <utility>

#ifdef __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-function"
#endif
#include "arm.h"
#ifdef __GNUC__
#pragma GCC diagnostic pop
#endif

/* Tolerance of tool poses [m, rad], largest step of a joint between poses [rad or m], halvings of a step of an arm. */
#define AT_POSE 1e-9
#define LONGEST_STRIDE 0.3
#define STRIDE_HALVINGS 3
/* Distances are known to within this share; where that decides, sharper. Halvings of a step between poses. */
#define COARSE 0.02
#define FINE 1e-6
#define MOST_HALVED 7

template <typename T>
static T taken(const nb::dict &arrays, const char *name, Py_ssize_t size) {
    T out;
    check_fit(out.take(nb::handle(arrays[name]).ptr()) && out.size == size, name);
    return out;
}

Edges::Edges(const nb::dict &arrays, const nb::list &given, Shapes &&shapes_given)
    : shapes(std::move(shapes_given)), pairs((Py_ssize_t)shapes.pairs()), joints((Py_ssize_t)shapes.joints()) {
    reach = taken<In>(arrays, "reach", joints * pairs), levers = taken<In>(arrays, "levers", pairs);
    required = taken<In>(arrays, "required", pairs), spare = taken<In>(arrays, "spare", pairs);
    lower = taken<In>(arrays, "lower", joints), upper = taken<In>(arrays, "upper", joints);
    const In settings = taken<In>(arrays, "settings", 2);
    sigma = settings.data[0], bent = settings.data[1];
    for (nb::handle one : given) {
        const nb::dict own = nb::borrow<nb::dict>(one);
        In numbers, columns;
        check_fit(numbers.take(nb::handle(own["numbers"]).ptr()) && columns.take(nb::handle(own["columns"]).ptr()));
        const In X = taken<In>(own, "T_object_tool", 12);
        OneArm arm;
        arm.n = (int)columns.size;
        check_fit(arm.n >= 1 && arm.n <= MOST_JOINTS && numbers.size == PER_JOINT * arm.n + 12);
        arm.numbers.assign(numbers.data, numbers.data + numbers.size);
        memcpy(arm.X, X.data, sizeof arm.X);
        for (Py_ssize_t i = 0; i < columns.size; i++) {
            check_fit(columns.data[i] >= 0.0 && columns.data[i] < (double)joints);
            arm.joint.push_back((Py_ssize_t)columns.data[i]);
        }
        arms.push_back(std::move(arm));
    }
    drop.resize((size_t)pairs), estimate.resize((size_t)pairs);
}

/* Where the tool is when the object is at a pose. */
static void tool_at(const double *pose, const double *X, double *tool) {
    multiply3(pose, X, tool);
    rotate(pose, X + 9, tool + 9);
    for (int i = 0; i < 3; i++) tool[9 + i] += pose[9 + i];
}

/* Whether the smallest singular value of the Jacobian is at least sigma: J Jᵀ − σ² I has a Cholesky factor. */
bool Edges::keeps_sigma(const OneArm &arm, const double *q) const {
    const Arm a = {arm.n, arm.numbers.data(), arm.numbers.data() + PER_JOINT * arm.n};
    double T[12], J[6 * MOST_JOINTS], G[36];
    const int m = arm.n < 6 ? arm.n : 6;
    place(&a, q, T, J);
    for (int i = 0; i < m; i++)
        for (int k = i; k < m; k++) {
            double sum = i == k ? -sigma * sigma : 0.0;
            if (arm.n < 6) sum += dot6(J + 6 * i, J + 6 * k);
            else
                for (int j = 0; j < arm.n; j++) sum += J[6 * j + i] * J[6 * j + k];
            G[6 * i + k] = sum;
        }
    for (int k = 0; k < m; k++) {
        if (!(G[7 * k] > 0.0)) return false;
        for (int i = k + 1; i < m; i++) {
            const double below = G[6 * k + i] / G[7 * k];
            for (int j = i; j < m; j++) G[6 * i + j] -= below * G[6 * k + j];
        }
    }
    return true;
}

/* All arms from one pose of the object to the next, from positions `at` to x, inside limits and off singularities. */
bool Edges::step_arms(const double *from, const double *to, const double *at, double *x, double *stop) {
    memcpy(x, at, sizeof(double) * (size_t)joints);
    for (size_t k = 0; k < arms.size(); k++) {
        const OneArm &arm = arms[k];
        const Arm a = {arm.n, arm.numbers.data(), arm.numbers.data() + PER_JOINT * arm.n};
        double q[MOST_JOINTS], before[12], after[12];
        tool_at(from, arm.X, before), tool_at(to, arm.X, after);
        for (int i = 0; i < arm.n; i++) q[i] = at[arm.joint[(size_t)i]];
        if (!step_to(&a, before, after, q, AT_POSE, LONGEST_STRIDE, STRIDE_HALVINGS)) {
            stop[0] = EDGE_REACH, stop[1] = (double)arm.joint[0];
            return false;
        }
        for (int i = 0; i < arm.n; i++) {
            const Py_ssize_t j = arm.joint[(size_t)i];
            if (!(q[i] >= lower.data[j] && q[i] <= upper.data[j])) {
                stop[0] = EDGE_LIMIT, stop[1] = (double)j;
                return false;
            }
            x[j] = q[i];
        }
        if (!keeps_sigma(arm, q)) {
            stop[0] = EDGE_SINGULAR, stop[1] = (double)arm.joint[0];
            return false;
        }
    }
    return true;
}

/* The most that each pair's distance can change between positions a and b, and a motion (2) of the object. */
void Edges::find_drops(const double *a, const double *b, const double *motion) {
    std::fill(drop.begin(), drop.end(), 0.0);
    for (Py_ssize_t j = 0; j < joints; j++) {
        const double way = bent * fabs(b[j] - a[j]), *own = reach.data + j * pairs;
        if (way == 0.0) continue;
        for (Py_ssize_t k = 0; k < pairs; k++) drop[(size_t)k] += own[k] * way;
    }
    for (Py_ssize_t k = 0; k < pairs; k++)
        drop[(size_t)k] = minimum(drop[(size_t)k], motion[0] + motion[1] * levers.data[k]);
}

/* The room of a pair, a lower bound of its distance less what is required, at positions x. */
double Edges::asked(Py_ssize_t k, const double *x, double tolerance) {
    shapes.place(x);
    return shapes.bound(k, INFINITY, tolerance) - required.data[k];
}

/* Whether all pairs keep their distance on a step from a to b; puts the rooms at b. */
bool Edges::is_clear(const double *from, const double *to, const double *motion, const double *a, const double *b,
                     double *rooms_a, double *rooms_b, double *stop) {
    find_drops(a, b, motion);
    open.clear();
    for (Py_ssize_t k = 0; k < pairs; k++) {
        rooms_b[k] = rooms_a[k] - drop[(size_t)k];
        if (rooms_b[k] < spare.data[k]) open.push_back(k);
    }
    for (size_t i = 1; i < open.size(); i++)
        if (open[i] == last) std::swap(open[0], open[i]);
    size_t kept = 0;
    for (const Py_ssize_t k : open) {
        double room = asked(k, b, COARSE);
        if (room < spare.data[k]) room = asked(k, b, FINE);
        if (room < spare.data[k]) {
            last = k, stop[0] = EDGE_PAIR, stop[1] = (double)k;
            return false;
        }
        rooms_b[k] = room;
        if (rooms_a[k] + room < drop[(size_t)k]) open[kept++] = k;
    }
    open.resize(kept);
    if (open.empty()) return true;
    kept = 0;
    for (const Py_ssize_t k : open) {
        rooms_a[k] = maximum(rooms_a[k], asked(k, a, FINE));
        if (rooms_a[k] + rooms_b[k] < drop[(size_t)k]) open[kept++] = k;
    }
    open.resize(kept);
    if (open.empty()) return true;
    const std::vector<Py_ssize_t> which = open;
    std::vector<double> at_a, at_b;
    for (const Py_ssize_t k : which) at_a.push_back(rooms_a[k]), at_b.push_back(rooms_b[k]);
    return halved(from, to, motion, a, b, which, at_a, at_b, 0, stop);
}

/* The same for some pairs, by halving the step. */
bool Edges::halved(const double *from, const double *to, const double *motion, const double *a, const double *b,
                   const std::vector<Py_ssize_t> &which, const std::vector<double> &rooms_a,
                   const std::vector<double> &rooms_b, int depth, double *stop) {
    double between[12], half[2] = {0.5 * motion[0], 0.5 * motion[1]};
    std::vector<double> middle((size_t)joints), first, second, at_a, at_m, to_m, to_b;
    std::vector<Py_ssize_t> left, right;
    halfway(from, to, between);
    if (!step_arms(from, between, a, middle.data(), stop)) return false;
    find_drops(a, middle.data(), half);
    for (const Py_ssize_t k : which) first.push_back(drop[(size_t)k]);
    find_drops(middle.data(), b, half);
    for (const Py_ssize_t k : which) second.push_back(drop[(size_t)k]);
    for (size_t i = 0; i < which.size(); i++) {
        const Py_ssize_t k = which[i];
        const double room = asked(k, middle.data(), FINE);
        const bool is_left = rooms_a[i] + room < first[i], is_right = room + rooms_b[i] < second[i];
        if (room < spare.data[k] || ((is_left || is_right) && depth >= MOST_HALVED)) {
            last = k, stop[0] = EDGE_PAIR, stop[1] = (double)k;
            return false;
        }
        if (is_left) left.push_back(k), at_a.push_back(rooms_a[i]), at_m.push_back(room);
        if (is_right) right.push_back(k), to_m.push_back(room), to_b.push_back(rooms_b[i]);
    }
    return (left.empty() || halved(from, between, half, a, middle.data(), left, at_a, at_m, depth + 1, stop)) &&
           (right.empty() || halved(between, to, half, middle.data(), b, right, to_m, to_b, depth + 1, stop));
}

Py_ssize_t Edges::walk(const In &poses, const In &motion, Out &positions, Out &rooms, Out &stop) {
    const Py_ssize_t count = poses.size / 12;
    check_fit(count > 0 && poses.size == 12 * count && motion.size == 2 * (count - 1) && stop.size == 2);
    check_fit(positions.size == count * joints && rooms.size == count * pairs);
    stop.data[0] = EDGE_FREE, stop.data[1] = 0.0;
    nb::gil_scoped_release released;
    for (Py_ssize_t i = 0; i + 1 < count; i++) {
        const double *from = poses.data + 12 * i, *to = from + 12, *moved = motion.data + 2 * i;
        double *a = positions.data + joints * i, *b = a + joints, *at = rooms.data + pairs * i;
        if (!step_arms(from, to, a, b, stop.data) || !is_clear(from, to, moved, a, b, at, at + pairs, stop.data)) return i;
    }
    return count - 1;
}

void Edges::measure(const In &x, Out &rooms) {
    check_fit(x.size == joints && rooms.size == pairs);
    for (Py_ssize_t k = 0; k < pairs; k++) rooms.data[k] = asked(k, x.data, FINE);
}

/* line(from, to, poses): poses along the straight edge between two, the last one to the last bit. */
static void line(const In &from, const In &to, Out &poses) {
    const Py_ssize_t count = poses.size / 12;
    check_fit(from.size == 12 && to.size == 12 && count >= 2 && poses.size == 12 * count);
    double D[9], w[3], turn[3], R[9];
    multiply3_back(from.data, to.data, D);
    rotation_vector(D, w);
    for (Py_ssize_t i = 0; i + 1 < count; i++) {
        const double share = (double)i / (double)(count - 1);
        double *pose = poses.data + 12 * i;
        for (int m = 0; m < 3; m++) turn[m] = share * w[m];
        exp3(turn, R);
        multiply3(from.data, R, pose);
        for (int m = 0; m < 3; m++) pose[9 + m] = from.data[9 + m] + share * (to.data[9 + m] - from.data[9 + m]);
    }
    memcpy(poses.data + 12 * (count - 1), to.data, 12 * sizeof(double));
}

static void build_edges(Edges *self, const nb::dict &arrays, const nb::list &arms, const nb::dict &shapes) {
    const auto array = [&](const char *name) {
        In out;
        check_fit(out.take(nb::handle(shapes[name]).ptr()), name);
        return out;
    };
    std::vector<In> corners;
    for (nb::handle of_one : nb::list(shapes["corners"])) {
        corners.emplace_back();
        check_fit(corners.back().take(of_one.ptr()));
    }
    new (self) Edges(arrays, arms, Shapes(array("axes"), array("carriers"), array("shapes"), corners, array("pairs")));
}

void bind_edges(nb::module_ &m) {
    m.def("line", line);
    nb::class_<Edges>(m, "Edges", "Edges of a search for the object's path.")
        .def("__init__", build_edges)
        .def("walk", &Edges::walk)
        .def("measure", &Edges::measure);
}
