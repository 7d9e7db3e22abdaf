/* See edges.h. */

#include "edges.h"

#include <math.h>
#include <string.h>

#include <algorithm>
#include <utility>

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
    check_fit(out.take(nb::handle(arrays[name]).ptr()) && (size < 0 || out.size == size), name);
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
        arm.X = *reinterpret_cast<const Pose *>(X.data);
        for (Py_ssize_t i = 0; i < columns.size; i++) {
            check_fit(columns.data[i] >= 0.0 && columns.data[i] < (double)joints);
            arm.joint.push_back((Py_ssize_t)columns.data[i]);
        }
        arms.push_back(std::move(arm));
    }
    const In shapes_held = taken<In>(arrays, "held", -1);
    check_fit(shapes_held.size % 13 == 0);
    for (const double *one = shapes_held.data; one < shapes_held.data + shapes_held.size; one += 13) {
        check_fit(one[0] >= 0.0 && one[0] < (double)pairs);
        held.push_back({(Py_ssize_t)one[0], *reinterpret_cast<const Pose *>(one + 1), 0.0});
    }
    drop.resize((size_t)pairs), estimate.resize((size_t)pairs);
}

/* Whether the smallest singular value of the Jacobian is at least sigma: J Jᵀ − σ² I has a Cholesky factor. */
bool Edges::keeps_sigma(const OneArm &arm, const double *q) const {
    ArmColumns J;
    place(arm.numbered(), q, J);
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 6, 6> G;
    if (arm.n < 6) G = J.transpose() * J;
    else G = J * J.transpose();
    G.diagonal().array() -= sigma * sigma;
    for (Eigen::Index k = 0; k < G.rows(); k++) {
        if (!(G(k, k) > 0.0)) return false;
        for (Eigen::Index i = k + 1; i < G.rows(); i++) {
            const double below = G(i, k) / G(k, k);
            for (Eigen::Index m = k + 1; m <= i; m++) G(i, m) -= below * G(m, k);
        }
    }
    return true;
}

/* All arms from one pose of the object to the next, from positions `at` to x, inside limits and off singularities. */
bool Edges::step_arms(const Pose &from, const Pose &to, const double *at, double *x, double *stop) {
    memcpy(x, at, sizeof(double) * (size_t)joints);
    for (size_t k = 0; k < arms.size(); k++) {
        const OneArm &arm = arms[k];
        const Pose before = compose(from, arm.X), after = compose(to, arm.X);
        double q[MOST_JOINTS];
        for (int i = 0; i < arm.n; i++) q[i] = at[arm.joint[(size_t)i]];
        if (!step_to(arm.numbered(), before, after, q, AT_POSE, LONGEST_STRIDE, STRIDE_HALVINGS)) {
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
bool Edges::is_clear(const Pose &from, const Pose &to, const double *motion, const double *a, const double *b,
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
bool Edges::halved(const Pose &from, const Pose &to, const double *motion, const double *a, const double *b,
                   const std::vector<Py_ssize_t> &which, const std::vector<double> &rooms_a,
                   const std::vector<double> &rooms_b, int depth, double *stop) {
    const Pose between = halfway(from, to);
    const double half[2] = {0.5 * motion[0], 0.5 * motion[1]};
    std::vector<double> middle((size_t)joints), first, second, at_a, at_m, to_m, to_b;
    std::vector<Py_ssize_t> left, right;
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
        const Pose &from = reinterpret_cast<const Pose *>(poses.data)[i], &to = *(&from + 1);
        const double *moved = motion.data + 2 * i;
        double *a = positions.data + joints * i, *b = a + joints, *at = rooms.data + pairs * i;
        if (!step_arms(from, to, a, b, stop.data) || !is_clear(from, to, moved, a, b, at, at + pairs, stop.data)) return i;
    }
    return count - 1;
}

Py_ssize_t Edges::object_along(const In &poses, const In &motion, const In &rooms) {
    const Py_ssize_t count = poses.size / 12;
    check_fit(count > 0 && poses.size == 12 * count && motion.size == 2 * (count - 1) && rooms.size == pairs);
    nb::gil_scoped_release released;
    for (Held &one : held) one.room = rooms.data[one.pair];
    for (Py_ssize_t i = 0; i + 1 < count; i++)
        for (Held &one : held) {
            const Py_ssize_t k = one.pair;
            one.room -= motion.data[2 * i] + motion.data[2 * i + 1] * levers.data[k];
            if (one.room >= spare.data[k]) continue;
            const Pose T = compose(reinterpret_cast<const Pose *>(poses.data)[i + 1], one.T_object_shape);
            one.room = shapes.bound_at(k, T, COARSE) - required.data[k];
            if (one.room < spare.data[k]) one.room = shapes.bound_at(k, T, FINE) - required.data[k];
            if (one.room < spare.data[k]) {
                std::swap(one, held.front()); /* it stops the next one, too */
                return i;
            }
        }
    return count - 1;
}

Py_ssize_t Edges::arms_along(const In &poses, Out &positions) {
    const Py_ssize_t count = poses.size / 12;
    check_fit(count > 0 && poses.size == 12 * count && positions.size == count * joints);
    nb::gil_scoped_release released;
    double stop[2];
    for (Py_ssize_t i = 0; i + 1 < count; i++) {
        const Pose &from = reinterpret_cast<const Pose *>(poses.data)[i];
        double *a = positions.data + joints * i;
        if (!step_arms(from, *(&from + 1), a, a + joints, stop)) return i;
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
    const Pose &a = *reinterpret_cast<const Pose *>(from.data), &b = *reinterpret_cast<const Pose *>(to.data);
    const Vector3 turn = rotation_vector(a.R.transpose() * b.R), way = b.p - a.p;
    for (Py_ssize_t i = 0; i + 1 < count; i++) {
        const double share = (double)i / (double)(count - 1);
        reinterpret_cast<Pose *>(poses.data)[i] = {a.R * exp3(share * turn), a.p + share * way};
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
        .def("object_along", &Edges::object_along)
        .def("arms_along", &Edges::arms_along)
        .def("measure", &Edges::measure);
}
