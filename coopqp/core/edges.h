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
#include "spans.h"
#include "nearby.h"

/* What stops an edge; 0 where nothing does. */
enum EdgeStop { EDGE_FREE, EDGE_REACH, EDGE_LIMIT, EDGE_SINGULAR, EDGE_PAIR };

/* What edges read: how far each joint moves each pair (nv, P), the levers of the object's turns (P), distances that are required
 * and rooms that are kept beside (P), and position limits (nv). */
struct EdgeArrays {
    Read reach, levers, required, spare, lower, upper;
};

/* line(from, to, poses): poses along the straight edge between two, the last one to the last bit. */
void line(Read from, Read to, Write poses);

class Edges : private EdgeArrays {
public:
    struct OneArm {
        std::vector<double> numbers; /* as arm.h takes them */
        std::vector<ptrdiff_t> joint;
        Pose X; /* the tool in the object's frame */
        int n;

        Arm numbered() const { return {n, numbers.data(), numbers.data() + PER_JOINT * n}; }
    };
    struct Held { /* a pair of the object with what stands, and its room */
        ptrdiff_t pair;
        Pose T_object_shape;
        double room;
    };
    Edges(const EdgeArrays &arrays, double sigma, double bent, std::vector<OneArm> &&arms, std::vector<Held> &&held,
          Shapes &&shapes);
    /* Along poses (K, 12) from joint positions and rooms at the first; between poses the object's origin moves by at most
     * `motion` (K − 1, 2) [m] and turns by [rad]. Fills positions (K, nv) and rooms (K, P) as far as it goes; `stop` (2) is
     * what stops it and the number of the joint or the pair. Returns the index of the last pose that is reached. */
    ptrdiff_t walk(Read poses, Read motion, Write positions, Write rooms, Write stop);
    /* The index of the last of such poses that the object alone gets to, from rooms (P) at the first: its pairs
     * with what stands are asked, at the poses only. */
    ptrdiff_t object_along(Read poses, Read motion, Read rooms);
    /* The index of the last of such poses that the arms get to from the first of positions (K, nv), which it fills. */
    ptrdiff_t arms_along(Read poses, Write positions);
    /* Rooms (P) at joint positions (nv). */
    void measure(Read x, Write rooms);

private:
    bool step_arms(const Pose &from, const Pose &to, const double *at, double *x, double *stop);
    bool keeps_sigma(const OneArm &arm, const double *q) const;
    void find_drops(const double *a, const double *b, const double *motion);
    double asked(ptrdiff_t k, const double *x, double tolerance);
    bool is_clear(const Pose &from, const Pose &to, const double *motion, const double *a, const double *b,
                  double *rooms_a, double *rooms_b, double *stop);
    bool halved(const Pose &from, const Pose &to, const double *motion, const double *a, const double *b,
                const std::vector<ptrdiff_t> &pairs, const std::vector<double> &rooms_a,
                const std::vector<double> &rooms_b, int depth, double *stop);

    Shapes shapes;
    std::vector<OneArm> arms;
    std::vector<Held> held;
    ptrdiff_t pairs, joints;
    double sigma, bent;
    std::vector<double> drop, estimate;
    std::vector<ptrdiff_t> open;
    ptrdiff_t last = -1; /* the pair that stopped the edge before */
};

#endif
