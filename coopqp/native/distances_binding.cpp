/* Lower bounds of distances for Python: functions, which bounds_plain.py says in NumPy, and Nearby. */

#include "arrays.h"
#include "bounds.h"
#include "nearby.h"

/* follow(rooms, reach, positions, x, continuous) */
static void follow_all(Out &rooms, const In &reach, Out &positions, const In &x, const In &continuous) {
    const Py_ssize_t joints = positions.size;
    check_fit(reach.size == rooms.size * joints && x.size == joints && continuous.size == joints);
    follow(rooms.data, reach.data, positions.data, x.data, continuous.data, rooms.size, joints);
}

/* certify(rooms, reach, spare, shares, out): False if a room is none */
static bool certify_rooms(const In &rooms, const In &reach, double spare, Out &shares, Out &out) {
    check_fit(shares.size == rooms.size && reach.size == rooms.size * out.size);
    return certify(rooms.data, reach.data, spare, shares.data, out.data, rooms.size, out.size) != 0;
}

/* near(rooms, watch): pairs whose room is below their watch */
static nb::list near(const In &rooms, const In &watch) {
    check_fit(watch.size == rooms.size);
    nb::list found;
    for (Py_ssize_t k = 0; k < rooms.size; k++)
        if (!(rooms.data[k] >= watch.data[k])) found.append(k);
    return found;
}

/* soonest(rooms, most, least): the pair whose room may be used up first */
static Py_ssize_t soonest_of(const In &rooms, const In &most, double least) {
    check_fit(most.size == rooms.size && rooms.size > 0);
    return soonest(rooms.data, most.data, least, rooms.size);
}

/* rows(ends, J, kinds, rooms, pairs, approach, G, lower) */
static void rows(const In &ends, const In &J, const In &kinds, const In &rooms, const nb::list &pairs, double approach,
                 Out &G, Out &lower) {
    const Py_ssize_t joints = J.size / 6, count = (Py_ssize_t)pairs.size();
    check_fit(joints > 0 && J.size == 6 * joints && ends.size == 6 * count && kinds.size == rooms.size * joints &&
              G.size == count * joints && lower.size == count);
    for (Py_ssize_t i = 0; i < count; i++) {
        const Py_ssize_t k = nb::cast<Py_ssize_t>(pairs[(size_t)i]);
        check_fit(k >= 0 && k < rooms.size);
        gradient(ends.data + 6 * i, J.data, kinds.data + k * joints, G.data + i * joints, joints);
        lower.data[i] = least_speed(rooms.data[k], approach);
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

void bind_distances(nb::module_ &m) {
    m.def("follow", follow_all);
    m.def("certify", certify_rooms);
    m.def("near", near);
    m.def("soonest", soonest_of);
    m.def("rows", rows);
    m.def("binding", binding);
    if (add_nearby(m.ptr()) < 0) throw nb::python_error();
}
