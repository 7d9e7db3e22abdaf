/* Lower bounds of distances for Python: functions, and Nearby. */

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "arrays.h"
#include "bounds.h"
#include "nearby.h"

/* follow(clearances, reach, positions, x, continuous) */
static void follow_all(Out &clearances, const In &reach, Out &positions, const In &x, const In &continuous) {
    const Py_ssize_t joints = positions.size;
    check_fit(reach.size == clearances.size * joints && x.size == joints && continuous.size == joints);
    follow(clearances.data, reach.data, positions.data, x.data, continuous.data, clearances.size, joints);
}

/* certify(clearances, reach, spare, shares, out): False if a clearance is none */
static bool certify_clearances(const In &clearances, const In &reach, double spare, Out &shares, Out &out) {
    check_fit(shares.size == clearances.size && reach.size == clearances.size * out.size);
    return certify(clearances.data, reach.data, spare, shares.data, out.data, clearances.size, out.size) != 0;
}

/* near(clearances, watch): pairs whose clearance is below their watch */
static nb::list near(const In &clearances, const In &watch) {
    check_fit(watch.size == clearances.size);
    nb::list found;
    for (Py_ssize_t k = 0; k < clearances.size; k++)
        if (!(clearances.data[k] >= watch.data[k])) found.append(k);
    return found;
}

/* soonest(clearances, most, least): the pair whose clearance may be used up first */
static Py_ssize_t soonest_of(const In &clearances, const In &most, double least) {
    check_fit(most.size == clearances.size && clearances.size > 0);
    return soonest(clearances.data, most.data, least, clearances.size);
}

/* rows(ends, J, kinds, clearances, pairs, approach, G, lower) */
static void rows(const In &ends, const In &J, const In &kinds, const In &clearances, const nb::list &pairs, double approach,
                 Out &G, Out &lower) {
    const Py_ssize_t joints = J.size / 6, count = (Py_ssize_t)pairs.size();
    check_fit(joints > 0 && J.size == 6 * joints && ends.size == 6 * count && kinds.size == clearances.size * joints &&
              G.size == count * joints && lower.size == count);
    for (Py_ssize_t i = 0; i < count; i++) {
        const Py_ssize_t k = nb::cast<Py_ssize_t>(pairs[(size_t)i]);
        check_fit(k >= 0 && k < clearances.size);
        gradient(ends.data + 6 * i, J.data, kinds.data + k * joints, G.data + i * joints, joints);
        lower.data[i] = least_speed(clearances.data[k], approach);
    }
}

/* binding(G, lower, fastest): rows that joint speeds can break */
static nb::list binding(const In &G, const In &lower, const In &fastest) {
    const Py_ssize_t joints = fastest.size;
    check_fit(G.size == lower.size * joints);
    nb::list found;
    for (Py_ssize_t i = 0; i < lower.size; i++)
        if (breakable(G.data + i * joints, lower.data[i], fastest.data, joints)) found.append(i);
    return found;
}

/* Nearby(arrays, settings, coal, shapes): see nearby.h. */
static void build_nearby(Nearby *self, const nb::dict &arrays, const std::vector<double> &settings, const nb::dict &coal,
                         const nb::dict &shapes) {
    const auto array = [](const nb::dict &given, const char *name, auto out) {
        check_fit(out.take(nb::handle(given[name]).ptr()));
        return out;
    };
    std::vector<In> corners;
    for (nb::handle of_one : nb::list(shapes["corners"])) {
        corners.emplace_back();
        check_fit(corners.back().take(of_one.ptr()));
    }
    check_fit(settings.size() == 4);
    new (self) Nearby(arrays, Settings{settings[0], settings[1], settings[2], settings[3]},
                      Coal(coal["owner"], coal["placing"], coal["ask"], coal["questions"], coal["answers"], coal["points"],
                           coal["normals"], array(coal, "q", Out()), array(coal, "q_index", In()),
                           array(coal, "continuous", In())),
                      Shapes(array(shapes, "axes", In()), array(shapes, "carriers", In()), array(shapes, "shapes", In()),
                             corners, array(shapes, "pairs", In())));
}

void bind_distances(nb::module_ &m) {
    m.def("follow", follow_all);
    m.def("certify", certify_clearances);
    m.def("near", near);
    m.def("soonest", soonest_of);
    m.def("rows", rows);
    m.def("binding", binding);
    nb::class_<Nearby>(m, "Nearby", "Rows of a compiled step beside bodies that stand, over its memory.")
        .def("__init__", build_nearby)
        .def("rows", &Nearby::rows)
        .def("clear", &Nearby::clear, nb::arg(), nb::arg() = false)
        .def("tightened", &Nearby::tightened)
        .def("stopping", &Nearby::stopping)
        .def("prepare", &Nearby::prepare)
        .def("surveys", &Nearby::surveys, nb::arg() = false)
        .def("evade", &Nearby::evade)
        .def("placement", &Nearby::placement)
        .def("bound", &Nearby::bound);
}
