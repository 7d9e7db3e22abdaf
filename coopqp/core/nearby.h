/* The rows of a compiled step beside bodies that stand, and what stops the object ahead, as coopqp/collision/clearance.py
 * has them for bodies that move. Lower bounds of distances follow the joints, or come from convex.h; coal is asked where
 * they are not enough, Pinocchio for placements then: a step that is not near asks neither. */

#ifndef COOPQP_NEARBY_H
#define COOPQP_NEARBY_H

#include <memory>
#include <optional>
#include <vector>

#include "spans.h"
#include "convex.h"
#include "survey.h"

/* Distances where they have to be exact, one pair at a time. */
class ExactDistances {
public:
    virtual ~ExactDistances() = default;
    virtual size_t pairs() const = 0;
    /* Put the shapes where they are at positions x. */
    virtual void place(const double *x) = 0;
    /* Distance of a pair where the shapes are placed, asked once. */
    virtual double distance(ptrdiff_t k) = 0;
    /* Unit normal and a nearest point of the second body of a pair that was asked; zeros without a depth. */
    virtual void ends(ptrdiff_t k, double *found) const = 0;
    /* The placement of the shapes is unknown. */
    virtual void lose() = 0;
};

/* The shapes, placed by kinematics of their own as far as pairs ask for it, and lower bounds of distances. */
class Shapes {
public:
    /* Of each joint: its axis and moment in the world at zero positions (6), and the joint that carries it or -1. Shapes:
     * kind, joint or -1, half sizes (3), radius, placement in the world at zero positions (R 9, p 3); corners of hulls. */
    Shapes(Read axes, Read carriers, Read shapes, const std::vector<Read> &corners, Read pairs);
    size_t joints() const { return joint.size(); }
    size_t pairs() const { return first.size(); }
    size_t size() const { return shape.size(); }
    void place(const double *x);
    /* A lower bound of the distance of a pair where the shapes are placed: `enough`, or as good as `tolerance`. */
    double bound(ptrdiff_t k, double enough, double tolerance);
    /* The same of a shape that stands and one that is held, where that one is put. */
    double bound_at(ptrdiff_t k, const Pose &T, double tolerance);
    /* The same as good as the distance, with the unit normal from the first shape to the second and a nearest point of the
     * second; they are NaN where the cores touch. */
    double gap(ptrdiff_t k, double *ends);
    /* Placement of a shape (R 9, p 3). */
    const Shape &placed(size_t i);
    /* Velocity at the world's origin and angular velocity of what a joint carries, per unit of its speed (6). */
    const Vector6 &twist(size_t j) { return placed_joint((int)j).twist; }

private:
    struct Joint {
        Vector3 axis, moment;
        Pose T;
        Vector6 twist;
        int carrier;
        uint64_t stamp = 0;
    };
    const Joint &placed_joint(int j);
    std::vector<Joint> joint;
    std::vector<Shape> shape;
    std::vector<uint64_t> stamps; /* of the shapes */
    std::vector<int> first, second;
    std::vector<Vector3> ways; /* of each pair a unit vector, where the next search begins */
    std::vector<double> x;     /* positions of the joints */
    uint64_t stamp = 1;
};

/* Of the scene: approach [1/s], clearance that a certificate spares, clearance where evasion begins, or negative for rows
 * of a step [m], rows at most. */
struct Settings {
    double approach, spare, evades, most_pairs;
};

/* The least self-motion of redundant arms that keeps rows: Evasion in coopqp/collision/evasion.py. */
class Evasion {
public:
    void begin() { rows.clear(), missing.clear(); }
    /* A row G of distances (joints) that lacks so much speed. */
    void add(const std::vector<double> &G, double lacks);
    /* Add self-motion of the arms (a number of each joint) to slopes, the shapes placed where they are. */
    void move(Shapes &shapes, Read arm, Read carries, Read speeds, double *slope);

private:
    void find_basis(Shapes &shapes, Read arm, Read carries, Read speeds);
    std::vector<double> rows, missing;
    std::vector<double> basis, turned, room; /* columns of N; G N; scratch of a move */
    std::vector<ptrdiff_t> helping;         /* rows that self-motion changes */
};

/* What Nearby reads and writes, and how many numbers: of the scene, P pairs and nv joints; of the step, rows of which fit as
 * many as `lower` has; of a grid point that is tried, or expected next; and of those ahead. */
#define NEARBY_ARRAYS(READ, WRITE) \
    WRITE(clearances, P) WRITE(at, nv) WRITE(counts, 2) READ(reach, nv * P) READ(margins, P) READ(most, P) READ(fastest, P) \
    READ(kinds, nv * P) READ(continuous, nv) READ(arm, nv) READ(carries, nv) READ(speeds, nv) READ(jacobian, 6 * nv) \
    READ(positions, nv) READ(command, nv) READ(dt, 1) WRITE(G, lower.size * nv) WRITE(lower, lower.size) \
    WRITE(upper, lower.size) WRITE(soft, lower.size) WRITE(owner, lower.size) WRITE(centre, nv) WRITE(weights, nv) \
    WRITE(slack, 1) WRITE(approach, 1) READ(evading_positions, nv) WRITE(evading_slope, nv) \
    READ(node_positions, node_positions.size) READ(node_slope, node_positions.size) READ(node_curvature, node_positions.size)

struct NearbyArrays {
#define READ(name, numbers) Read name;
#define WRITE(name, numbers) Write name;
    NEARBY_ARRAYS(READ, WRITE)
#undef READ
#undef WRITE
};

class Nearby : private NearbyArrays {
public:
    Nearby(const NearbyArrays &arrays, const Settings &settings, std::unique_ptr<ExactDistances> exact, Shapes &&shapes);
    /* Put the rows of this step, and where none binds, into its memory; how many. */
    long rows(bool blind);
    /* Whether no row can bind the command in memory, without asking for all that is near; if not shorter, some more is asked
     * for the next ones. */
    bool clear(bool blind, bool shorter);
    /* Raise lower bounds where the command leads closer than rows say; whether it does. */
    bool tightened();
    /* The pair that stops the object between the grid point at a place and the one before, a time `span` earlier, -2 for none, -1 if that is not known. */
    ptrdiff_t stopping(ptrdiff_t place, double span);
    /* Look at all pairs where the joints start, before the first step. */
    void prepare();
    /* A piece of work ahead of need, if there is any, or a shorter one; whether there was. Ahead it is on the grid point that is
     * expected next. */
    bool surveys(bool shorter);
    /* Self-motion of redundant arms where a grid point is tried: changes the slope in memory. */
    bool evade();
    /* The placement of a shape at positions x, by these kinematics. */
    void placement(Read x, ptrdiff_t shape, Write found);
    /* A sharp lower bound of the distance of a pair at positions x. */
    double bound(Read x, ptrdiff_t pair);

private:
    struct Arrival { /* at a grid point, a time after the one before */
        const double *x, *slope, *curvature;
        double span;
    };
    struct Sample {
        double back, clearance;
    };
    struct Gap {
        ptrdiff_t pair;
        double clearance, ends[6];
    };
    enum Job { IDLE, ASKING, GAPS, DONE }; /* work that is spread: none, pairs are looked at, gaps found, all is done */

    struct Measured {
        Nearby *all;
        double operator()(ptrdiff_t k) const;
    } measured = {this};

    double bounded(ptrdiff_t k, const double *x, double enough, double tolerance);
    double asked(ptrdiff_t k, const double *x);
    bool is_sharp(ptrdiff_t k) const { return sharp[(size_t)k] == sharp_stamp; }
    void follow(const double *x);
    double approach_of(bool blind) const;
    void begin(bool blind);
    void set_watches(double approach, double range);
    std::optional<size_t> find_near();
    ptrdiff_t soonest_close() const;
    void sharpen(int most);
    void put_certificate();
    bool way_is_clear(const double *x);
    double used_at(const double *x);
    bool look_for_certificate(int some);
    bool look_for_node();
    bool look_for_gaps();
    bool lacks_speed(const double *slope, double share);
    const Gap &gap_of(ptrdiff_t k);
    double clearance_at(ptrdiff_t k, const double *x, double enough);
    double clearance_before(ptrdiff_t k, const Arrival &to, double back, double enough);
    bool falls_below(ptrdiff_t k, const Arrival &to, double least, Sample late, Sample early, double way);
    bool crosses(ptrdiff_t k, const Arrival &to, double way);
    double least_speed_of(double spare) const;

    Settings set;
    std::unique_ptr<ExactDistances> exact;
    Shapes shapes;
    ptrdiff_t pairs, joints;
    Evasion evasion;
    Survey survey;
    Way motion;                              /* in a step, or to a grid point */
    std::vector<double> watch, next, coming; /* coming: motion of the joints to the next grid point, as the last one had it */
    std::vector<uint64_t> sharp;             /* clearances with the present stamp are as good as distances */
    uint64_t sharp_stamp = 1;
    std::vector<ptrdiff_t> near, which; /* near pairs, pairs of the rows */
    std::vector<Gap> gaps;               /* of pairs where the joints are `at`, with the stamp below */
    uint64_t gaps_stamp = 0;
    double watch_of[2] = {};             /* approach and range of the watches */
    Job job = IDLE;
    int looked = 0; /* of this job */
};

#endif
