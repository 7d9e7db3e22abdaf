/* Distances, edges and clocks for Python: functions, Nearby over coal and over the memory of a step, and Edges. */

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "arrays.h"
#include "bounds.h"
#include "edges.h"
#include "limited_clock.h"
#include "rounded.h"

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

/* Distances by coal, one pair at a time, where Pinocchio has placed the shapes. */
class Coal : public ExactDistances {
public:
    Coal(nb::object owner, nb::list placing, nb::callable ask, nb::list questions, nb::list answers, nb::list points,
         const nb::list &normals, Out q, In q_index, In continuous);
    size_t pairs() const override { return normals.size(); }
    void place(const double *x) override;
    bool knows(ptrdiff_t k) const { return known[(size_t)k] == stamp; }
    double distance(ptrdiff_t k) override;
    void ends(ptrdiff_t k, double *found) const override;
    void lose() override { lost = true; }

private:
    nb::object owner; /* owns the memory that coal writes */
    nb::list placing, questions, answers, points;
    nb::callable ask;
    Out q;
    In q_index, continuous;
    std::vector<const double *> normals; /* of each pair, in coal's memory */
    std::vector<double> d, at;
    std::vector<uint64_t> known; /* distances with the present stamp are of this placement */
    uint64_t stamp = 1;
    bool lost = true; /* the placement of the shapes is unknown */
};

/* Joints this close to their placed positions need no new placement [rad or m]: a step's end is the next one's start. */
constexpr double SAME_PLACE = 1e-14;

Coal::Coal(nb::object owner_given, nb::list placing_given, nb::callable ask_given, nb::list questions_given,
           nb::list answers_given, nb::list points_given, const nb::list &normals_given, Out q_given, In q_index_given,
           In continuous_given)
    : owner(std::move(owner_given)), placing(std::move(placing_given)), questions(std::move(questions_given)),
      answers(std::move(answers_given)), points(std::move(points_given)), ask(std::move(ask_given)),
      q(std::move(q_given)), q_index(std::move(q_index_given)), continuous(std::move(continuous_given)) {
    for (nb::handle normal : normals_given) {
        In view; /* stays there as long as its owner */
        check_fit(view.take(normal.ptr()) && view.size == 3);
        normals.push_back(view.data);
    }
    check_fit(questions.size() == pairs() && answers.size() == pairs() && points.size() == pairs());
    check_fit(q_index.size == continuous.size);
    for (ptrdiff_t j = 0; j < q_index.size; j++)
        check_fit(q_index.data[j] >= 0.0 && q_index.data[j] + (continuous.data[j] != 0.0 ? 2.0 : 1.0) <= (double)q.size);
    d.resize(pairs()), known.resize(pairs()), at.resize((size_t)q_index.size);
}

void Coal::place(const double *x) {
    double away = lost ? INFINITY : 0.0;
    for (size_t j = 0; j < at.size(); j++) away = fmax(away, fabs(x[j] - at[j]));
    if (away <= SAME_PLACE) return;
    for (size_t j = 0; j < at.size(); j++) {
        double *own = q.data + (ptrdiff_t)q_index.data[j];
        own[0] = x[j];
        if (continuous.data[j] != 0.0) own[0] = cos(x[j]), own[1] = sin(x[j]);
    }
    at.assign(x, x + at.size());
    stamp++, lost = true;
    for (nb::handle function : placing) function();
    lost = false;
}

double Coal::distance(ptrdiff_t k) {
    if (knows(k)) return d[(size_t)k];
    ask(*questions[(size_t)k]);
    d[(size_t)k] = maximum(DEEPEST, nb::cast<double>(answers[(size_t)k].attr("min_distance")));
    known[(size_t)k] = stamp;
    return d[(size_t)k];
}

void Coal::ends(ptrdiff_t k, double *found) const {
    In point;
    const nb::object given = points[(size_t)k]();
    check_fit(point.take(given.ptr()) && point.size == 3, "a point has three numbers");
    memcpy(found, normals[(size_t)k], 3 * sizeof(double));
    memcpy(found + 3, point.data, 3 * sizeof(double));
    for (int e = 0; e < 6; e++) /* of an overlap whose depth coal did not find */
        if (!(fabs(found[e]) < FARTHEST_POINT)) memset(found, 0, 6 * sizeof(double));
}

/* Arrays of dictionaries, which are held. */
struct Taken {
    std::vector<In> read;
    std::vector<Out> written;

    Taken() = default;
    Taken(Taken &&) = default;

    Read in(const nb::dict &given, const char *name) {
        check_fit(read.emplace_back().take(nb::handle(given[name]).ptr()));
        return read.back();
    }
    Write out(const nb::dict &given, const char *name) {
        check_fit(written.emplace_back().take(nb::handle(given[name]).ptr()));
        return written.back();
    }
};

/* What reads and writes them. */
template <typename Reader>
struct Holding : Taken, Reader {
    template <typename... Args>
    Holding(Taken &&taken, Args &&...args) : Taken(std::move(taken)), Reader(std::forward<Args>(args)...) {}
};

static Shapes shapes_of(const nb::dict &shapes) {
    Taken taken;
    std::vector<In> held;
    std::vector<Read> corners;
    for (nb::handle of_one : nb::list(shapes["corners"])) {
        check_fit(held.emplace_back().take(of_one.ptr()));
        corners.push_back(held.back());
    }
    return Shapes(taken.in(shapes, "axes"), taken.in(shapes, "carriers"), taken.in(shapes, "shapes"), corners,
                  taken.in(shapes, "pairs"));
}

/* Nearby(arrays, settings, coal, shapes): see nearby.h. */
static void build_nearby(Holding<Nearby> *self, const nb::dict &arrays, const std::vector<double> &settings, const nb::dict &coal,
                         const nb::dict &shapes) {
    const auto own = [&coal](const char *name, auto array) {
        check_fit(array.take(nb::handle(coal[name]).ptr()));
        return array;
    };
    check_fit(settings.size() == 4);
    Taken taken;
    ::NearbyArrays found;
#define READ(name, numbers) found.name = taken.in(arrays, #name);
#define WRITE(name, numbers) found.name = taken.out(arrays, #name);
    NEARBY_ARRAYS(READ, WRITE)
    auto exact = std::make_unique<Coal>(coal["owner"], coal["placing"], coal["ask"], coal["questions"], coal["answers"],
                                        coal["points"], coal["normals"], own("q", Out()), own("q_index", In()),
                                        own("continuous", In()));
    new (self) Holding<Nearby>(std::move(taken), found, Settings{settings[0], settings[1], settings[2], settings[3]},
                               std::move(exact), shapes_of(shapes));
}

/* Edges(arrays, arms, shapes): see edges.h. */
static void build_edges(Holding<Edges> *self, const nb::dict &arrays, const nb::list &given, const nb::dict &shapes) {
    Taken taken, other;
    std::vector<Edges::OneArm> arms;
    std::vector<Edges::Held> held;
    for (nb::handle one : given) {
        const nb::dict own = nb::borrow<nb::dict>(one);
        const Read numbers = other.in(own, "numbers"), columns = other.in(own, "columns"), X = other.in(own, "T_object_tool");
        check_fit(X.size == 12);
        arms.push_back({{numbers.data, numbers.data + numbers.size}, {}, *reinterpret_cast<const Pose *>(X.data),
                        (int)columns.size});
        for (ptrdiff_t i = 0; i < columns.size; i++) arms.back().joint.push_back((ptrdiff_t)columns.data[i]);
    }
    const Read pairs = other.in(arrays, "held"), settings = other.in(arrays, "settings");
    check_fit(pairs.size % 13 == 0 && settings.size == 2);
    for (const double *one = pairs.data; one < pairs.data + pairs.size; one += 13)
        held.push_back({(ptrdiff_t)one[0], *reinterpret_cast<const Pose *>(one + 1), 0.0});
    const auto array = [&](const char *name) { return taken.in(arrays, name); };
    const EdgeArrays found = {array("reach"), array("levers"), array("required"), array("spare"), array("lower"), array("upper")};
    new (self) Holding<Edges>(std::move(taken), found, settings.data[0], settings.data[1], std::move(arms), std::move(held),
                              shapes_of(shapes));
}

/* limited_rate(points, count, period of the commands, point, point before, most, most change, sigma, period, wanted, last) */
static double limited_rate_of(const In &points, ptrdiff_t count, double every, const In &point, const In &before, const In &most,
                              const In &most_change, double sigma, double period, double wanted, double last) {
    const ptrdiff_t n = point.size, rows = points.length(0);
    check_fit(points.length(1) == n + 1 && rows >= 8 && count >= 4 && before.size == n && most.size == n &&
              most_change.size == n);
    return limited_rate({points.data, count, rows / 2, n, every}, point.data, before.data, most.data, most_change.data, sigma,
                        period, wanted, last);
}

void bind_distances(nb::module_ &m) {
    m.def("follow", follow_all);
    m.def("certify", certify_clearances);
    m.def("near", near);
    m.def("soonest", soonest_of);
    m.def("rows", rows);
    m.def("binding", binding);
    nb::class_<Holding<Nearby>>(m, "Nearby", "Rows of a compiled step beside bodies that stand, over its memory.")
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
    m.def("line", line);
    m.def("rounded", rounded);
    m.def("limited_rate", limited_rate_of);
    const nb::call_guard<nb::gil_scoped_release> alone;
    nb::class_<Holding<Edges>>(m, "Edges", "Edges of a search for the object's path.")
        .def("__init__", build_edges)
        .def("walk", &Holding<Edges>::walk, alone)
        .def("object_along", &Holding<Edges>::object_along, alone)
        .def("arms_along", &Holding<Edges>::arms_along, alone)
        .def("measure", &Holding<Edges>::measure);
}
