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

Edges::Edges(const EdgeArrays &arrays, double sigma_given, double bent_given, std::vector<OneArm> &&arms_given,
             std::vector<Held> &&held_given, Shapes &&shapes_given)
    : EdgeArrays(arrays), shapes(std::move(shapes_given)), arms(std::move(arms_given)), held(std::move(held_given)),
      pairs((ptrdiff_t)shapes.pairs()), joints((ptrdiff_t)shapes.joints()), sigma(sigma_given), bent(bent_given) {
    check_fit(reach.size == joints * pairs && lower.size == joints && upper.size == joints);
    for (const Read *of_pairs : {&levers, &required, &spare}) check_fit(of_pairs->size == pairs);
    for (const OneArm &arm : arms) {
        check_fit(arm.n >= 1 && arm.n <= MOST_JOINTS && arm.numbers.size() == (size_t)(PER_JOINT * arm.n + 12));
        for (const ptrdiff_t j : arm.joint) check_fit(j >= 0 && j < joints);
    }
    for (const Held &one : held) check_fit(one.pair >= 0 && one.pair < pairs);
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
            const ptrdiff_t j = arm.joint[(size_t)i];
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
    for (ptrdiff_t j = 0; j < joints; j++) {
        const double way = bent * fabs(b[j] - a[j]), *own = reach.data + j * pairs;
        if (way == 0.0) continue;
        for (ptrdiff_t k = 0; k < pairs; k++) drop[(size_t)k] += own[k] * way;
    }
    for (ptrdiff_t k = 0; k < pairs; k++)
        drop[(size_t)k] = minimum(drop[(size_t)k], motion[0] + motion[1] * levers.data[k]);
}

/* The room of a pair, a lower bound of its distance less what is required, at positions x. */
double Edges::asked(ptrdiff_t k, const double *x, double tolerance) {
    shapes.place(x);
    return shapes.bound(k, INFINITY, tolerance) - required.data[k];
}

/* Whether all pairs keep their distance on a step from a to b; puts the rooms at b. */
bool Edges::is_clear(const Pose &from, const Pose &to, const double *motion, const double *a, const double *b,
                     double *rooms_a, double *rooms_b, double *stop) {
    find_drops(a, b, motion);
    open.clear();
    for (ptrdiff_t k = 0; k < pairs; k++) {
        rooms_b[k] = rooms_a[k] - drop[(size_t)k];
        if (rooms_b[k] < spare.data[k]) open.push_back(k);
    }
    for (size_t i = 1; i < open.size(); i++)
        if (open[i] == last) std::swap(open[0], open[i]);
    size_t kept = 0;
    for (const ptrdiff_t k : open) {
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
    for (const ptrdiff_t k : open) {
        rooms_a[k] = maximum(rooms_a[k], asked(k, a, FINE));
        if (rooms_a[k] + rooms_b[k] < drop[(size_t)k]) open[kept++] = k;
    }
    open.resize(kept);
    if (open.empty()) return true;
    const std::vector<ptrdiff_t> which = open;
    std::vector<double> at_a, at_b;
    for (const ptrdiff_t k : which) at_a.push_back(rooms_a[k]), at_b.push_back(rooms_b[k]);
    return halved(from, to, motion, a, b, which, at_a, at_b, 0, stop);
}

/* The same for some pairs, by halving the step. */
bool Edges::halved(const Pose &from, const Pose &to, const double *motion, const double *a, const double *b,
                   const std::vector<ptrdiff_t> &which, const std::vector<double> &rooms_a,
                   const std::vector<double> &rooms_b, int depth, double *stop) {
    const Pose between = halfway(from, to);
    const double half[2] = {0.5 * motion[0], 0.5 * motion[1]};
    std::vector<double> middle((size_t)joints), first, second, at_a, at_m, to_m, to_b;
    std::vector<ptrdiff_t> left, right;
    if (!step_arms(from, between, a, middle.data(), stop)) return false;
    find_drops(a, middle.data(), half);
    for (const ptrdiff_t k : which) first.push_back(drop[(size_t)k]);
    find_drops(middle.data(), b, half);
    for (const ptrdiff_t k : which) second.push_back(drop[(size_t)k]);
    for (size_t i = 0; i < which.size(); i++) {
        const ptrdiff_t k = which[i];
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

ptrdiff_t Edges::walk(Read poses, Read motion, Write positions, Write rooms, Write stop) {
    const ptrdiff_t count = poses.size / 12;
    check_fit(count > 0 && poses.size == 12 * count && motion.size == 2 * (count - 1) && stop.size == 2);
    check_fit(positions.size == count * joints && rooms.size == count * pairs);
    stop.data[0] = EDGE_FREE, stop.data[1] = 0.0;
    for (ptrdiff_t i = 0; i + 1 < count; i++) {
        const Pose &from = reinterpret_cast<const Pose *>(poses.data)[i], &to = *(&from + 1);
        const double *moved = motion.data + 2 * i;
        double *a = positions.data + joints * i, *b = a + joints, *at = rooms.data + pairs * i;
        if (!step_arms(from, to, a, b, stop.data) || !is_clear(from, to, moved, a, b, at, at + pairs, stop.data)) return i;
    }
    return count - 1;
}

ptrdiff_t Edges::object_along(Read poses, Read motion, Read rooms) {
    const ptrdiff_t count = poses.size / 12;
    check_fit(count > 0 && poses.size == 12 * count && motion.size == 2 * (count - 1) && rooms.size == pairs);
    for (Held &one : held) one.room = rooms.data[one.pair];
    for (ptrdiff_t i = 0; i + 1 < count; i++)
        for (Held &one : held) {
            const ptrdiff_t k = one.pair;
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

ptrdiff_t Edges::arms_along(Read poses, Write positions) {
    const ptrdiff_t count = poses.size / 12;
    check_fit(count > 0 && poses.size == 12 * count && positions.size == count * joints);
    double stop[2];
    for (ptrdiff_t i = 0; i + 1 < count; i++) {
        const Pose &from = reinterpret_cast<const Pose *>(poses.data)[i];
        double *a = positions.data + joints * i;
        if (!step_arms(from, *(&from + 1), a, a + joints, stop)) return i;
    }
    return count - 1;
}

void Edges::measure(Read x, Write rooms) {
    check_fit(x.size == joints && rooms.size == pairs);
    for (ptrdiff_t k = 0; k < pairs; k++) rooms.data[k] = asked(k, x.data, FINE);
}

void line(Read from, Read to, Write poses) {
    const ptrdiff_t count = poses.size / 12;
    check_fit(from.size == 12 && to.size == 12 && count >= 2 && poses.size == 12 * count);
    const Pose &a = *reinterpret_cast<const Pose *>(from.data), &b = *reinterpret_cast<const Pose *>(to.data);
    const Vector3 turn = rotation_vector(a.R.transpose() * b.R), way = b.p - a.p;
    for (ptrdiff_t i = 0; i + 1 < count; i++) {
        const double share = (double)i / (double)(count - 1);
        reinterpret_cast<Pose *>(poses.data)[i] = {a.R * exp3(share * turn), a.p + share * way};
    }
    memcpy(poses.data + 12 * (count - 1), to.data, 12 * sizeof(double));
}
