/* Edges of a search for the object's path: all arms walk along poses of the object, and distances are kept between them,
 * too. See coopqp/collision/edges.py. */

#ifndef COOPQP_EDGES_H
#define COOPQP_EDGES_H

#include <vector>

#ifdef __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-function" /* some of an arm's are for its batches only */
#endif
#include "arm.h"
#ifdef __GNUC__
#pragma GCC diagnostic pop
#endif
#include "binding/arrays.h"
#include "nearby.h"

/* What stops an edge; 0 where nothing does. */
enum EdgeStop { EDGE_FREE, EDGE_REACH, EDGE_LIMIT, EDGE_SINGULAR, EDGE_PAIR };

class Edges {
public:
    Edges(const nb::dict &arrays, const nb::list &arms, Shapes &&shapes);
    /* Along poses (K, 12) from joint positions and rooms at the first; between poses the object's origin moves by at most
     * `motion` (K − 1, 2) [m] and turns by [rad]. Fills positions (K, nv) and rooms (K, P) as far as it goes; `stop` (2) is
     * what stops it and the number of the joint or the pair. Returns the index of the last pose that is reached. */
    Py_ssize_t walk(const In &poses, const In &motion, Out &positions, Out &rooms, Out &stop);
    /* The index of the last of such poses that the object alone gets to, from rooms (P) at the first: its pairs
     * with what stands are asked, at the poses only. */
    Py_ssize_t object_along(const In &poses, const In &motion, const In &rooms);
    /* The index of the last of such poses that the arms get to from the first of positions (K, nv), which it fills. */
    Py_ssize_t arms_along(const In &poses, Out &positions);
    /* Rooms (P) at joint positions (nv). */
    void measure(const In &x, Out &rooms);

private:
    struct OneArm {
        std::vector<double> numbers; /* as arm.h takes them */
        std::vector<Py_ssize_t> joint;
        Pose X; /* the tool in the object's frame */
        int n;

        Arm numbered() const { return {n, numbers.data(), numbers.data() + PER_JOINT * n}; }
    };
    struct Held { /* a pair of the object with what stands, and its room */
        Py_ssize_t pair;
        Pose T_object_shape;
        double room;
    };
    bool step_arms(const Pose &from, const Pose &to, const double *at, double *x, double *stop);
    bool keeps_sigma(const OneArm &arm, const double *q) const;
    void find_drops(const double *a, const double *b, const double *motion);
    double asked(Py_ssize_t k, const double *x, double tolerance);
    bool is_clear(const Pose &from, const Pose &to, const double *motion, const double *a, const double *b,
                  double *rooms_a, double *rooms_b, double *stop);
    bool halved(const Pose &from, const Pose &to, const double *motion, const double *a, const double *b,
                const std::vector<Py_ssize_t> &pairs, const std::vector<double> &rooms_a,
                const std::vector<double> &rooms_b, int depth, double *stop);

    Shapes shapes;
    std::vector<OneArm> arms;
    std::vector<Held> held;
    Py_ssize_t pairs, joints;
    In reach, levers, required, spare, lower, upper; /* reach: (nv, P) */
    double sigma, bent;
    std::vector<double> drop, estimate;
    std::vector<Py_ssize_t> open;
    Py_ssize_t last = -1; /* the pair that stopped the edge before */
};

#endif
