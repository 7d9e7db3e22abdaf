/* Kinematics of one arm at many configurations, for Python: tool poses, Newton's method, walks along poses, derivatives
 * along a way; singular values of many matrices (values.cpp). See arm.h for the layout of the numbers. */

#include "arm.h"
#include "arrays.h"
#include "values.h"

/* The fastest that this processor can do. */
static SingularValues *fastest(void) {
#ifdef HAS_AVX2_ARITHMETIC
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return avx2::singular_values;
#endif
    return plain::singular_values;
}

/* -- Python ---------------------------------------------------------------------------------------------------------- */

static Arm arm_of(const In &numbers) {
    const Py_ssize_t joints = (numbers.size - 12) / PER_JOINT;
    check_fit(joints >= 1 && joints <= MOST_JOINTS && numbers.size == PER_JOINT * joints + 12);
    return {(int)joints, numbers.data, numbers.data + PER_JOINT * joints};
}

static Pose *poses_in(Out &numbers) { return reinterpret_cast<Pose *>(numbers.data); }
static const Pose *poses_in(const In &numbers) { return reinterpret_cast<const Pose *>(numbers.data); }

/* place(arm, q, poses, jacobians) */
static void place_all(const In &arm, const In &q, Out &poses, Out &jacobians) {
    const Arm a = arm_of(arm);
    const Py_ssize_t count = poses.size / 12, n = a.joints;
    check_fit(poses.size == 12 * count && q.size == n * count && jacobians.size == 6 * q.size);
    for (Py_ssize_t i = 0; i < count; i++) poses_in(poses)[i] = place(a, q.data + i * n, jacobians.data + 6 * i * n);
}

/* solve(arm, poses, q, residuals, tolerance, steps, longest, damping) */
static void solve_all(const In &arm, const In &poses, Out &q, Out &residuals, double tolerance, int steps, double longest,
                      double damping) {
    const Arm a = arm_of(arm);
    const Py_ssize_t count = residuals.size, n = a.joints;
    check_fit(poses.size == 12 * count && q.size == n * count);
    nb::gil_scoped_release released;
    for (Py_ssize_t i = 0; i < count; i++)
        residuals.data[i] = solve(a, poses_in(poses)[i], q.data + i * n, tolerance, steps, longest, damping);
}

/* derivatives(arm, q, twists, slopes of twists, slopes, curvatures) */
static void derivatives_all(const In &arm, const In &q, const In &twists, const In &twist_slopes, Out &slopes,
                            Out &curvatures) {
    const Arm a = arm_of(arm);
    using Six = Eigen::Map<const Vector6>;
    const Py_ssize_t count = twists.size / 6, n = a.joints;
    check_fit(twists.size == 6 * count && twist_slopes.size == twists.size && q.size == n * count &&
              slopes.size == q.size && curvatures.size == q.size);
    nb::gil_scoped_release released;
    for (Py_ssize_t i = 0, j = 0; i < count; i++, j += n)
        derivatives(a, q.data + j, Six(twists.data + 6 * i), Six(twist_slopes.data + 6 * i), slopes.data + j,
                    curvatures.data + j);
}

/* singular_values(matrices, rows, columns, values) */
static void singular_values_all(const In &matrices, int rows, int columns, Out &found) {
    const int width = rows < columns ? rows : columns, length = rows < columns ? columns : rows;
    check_fit(width >= 1 && width <= MOST_VALUES && length <= MOST_ROWS);
    const Py_ssize_t count = found.size / width;
    check_fit(found.size == width * count && matrices.size == rows * columns * count);
    nb::gil_scoped_release released;
    fastest()(matrices.data, count, rows, columns, found.data);
}

/* walk(arm, poses, q, reached, tolerance, longest, halvings) */
static void walk_all(const In &arm, const In &path, Out &walked, Out &reached, double tolerance, double longest,
                     int halvings) {
    const Arm a = arm_of(arm);
    const Py_ssize_t poses = path.size / 12, count = reached.size, n = a.joints;
    check_fit(path.size == 12 * poses && poses > 0 && walked.size == count * poses * n);
    nb::gil_scoped_release released;
    for (Py_ssize_t i = 0; i < count; i++)
        reached.data[i] = (double)walk(a, poses_in(path), poses, walked.data + i * poses * n, tolerance, longest, halvings);
}

void bind_kinematics(nb::module_ &m) {
    m.def("place", place_all);
    m.def("solve", solve_all);
    m.def("derivatives", derivatives_all);
    m.def("singular_values", singular_values_all);
    m.def("walk", walk_all);
}
