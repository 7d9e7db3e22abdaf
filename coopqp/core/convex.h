/* Convex shapes on joints, and lower bounds of their distances by the method of Gilbert, Johnson and Keerthi.
 *
 * A shape is a core and a radius about it. For any unit vector n the distance of two shapes is at least the gap between
 * their projections on n, so each iteration gives a bound that holds, whatever the rounding before it. */

#ifndef COOPQP_CONVEX_H
#define COOPQP_CONVEX_H

#include <math.h>
#include <string.h>

#include <vector>

#include "spatial.h"

/* Iterations; a bound within this share of the distance, or this far [m] from it, is as good as the distance. Cores that
 * are closer than the last number touch [m]. */
#define MOST_GJK 24
#define GJK_SHARE 1e-9
#define GJK_FLOOR 1e-10
#define CORES_TOUCH 1e-9

/* Points and segments, of spheres and capsules, are boxes without width. */
enum ShapeKind { BOX, CYLINDER, HULL };

/* A shape is placed at zero positions of the joints, and where the joints are placed. */
struct Shape {
    int kind = BOX, joint = -1; /* the joint that carries it; -1 for the world */
    Vector3 half = Vector3::Zero();
    double radius = 0.0; /* of a cylinder: radius, -, half of its length */
    Pose at_zero, T;
    std::vector<double> corners; /* of a hull */
};

/* The point of the core that is farthest along a direction. */
inline Vector3 farthest(const Shape &s, const Vector3 &way) {
    const Vector3 d = s.T.R.transpose() * way;
    Vector3 at = s.half;
    if (s.kind == BOX) {
        for (int i = 0; i < 3; i++) at[i] = d[i] < 0.0 ? -s.half[i] : s.half[i];
    } else if (s.kind == CYLINDER) {
        const double across = sqrt(d[0] * d[0] + d[1] * d[1]), share = across > 0.0 ? s.half[0] / across : 0.0;
        at = {share * d[0], share * d[1], d[2] < 0.0 ? -s.half[2] : s.half[2]};
    } else {
        double most = -INFINITY;
        const double *best = s.corners.data();
        for (const double *c = best, *end = c + s.corners.size(); c < end; c += 3) {
            const double far = c[0] * d[0] + c[1] * d[1] + c[2] * d[2];
            if (far > most) most = far, best = c;
        }
        at = Eigen::Map<const Vector3>(best);
    }
    return s.T.p + s.T.R * at;
}

/* Up to four points b - a of two cores, the point b of each, and the shares of their nearest point to the origin. */
struct Simplex {
    int size = 0;
    Vector3 w[4], b[4];
    double share[4];
};

/* Shares of the point of some of its points that is nearest to the origin, in `share`; its square. */
inline double nearest_of(const Simplex &s, const int *which, int size, double *share) {
    const Vector3 &a = s.w[which[0]];
    share[0] = 1.0, share[1] = share[2] = 0.0;
    if (size == 1) return a.squaredNorm();
    const Vector3 ab = s.w[which[1]] - a, ac = s.w[which[size - 1]] - a;
    const double d1 = -ab.dot(a), bb = ab.dot(ab), d2 = -ac.dot(a), cc = ac.dot(ac), bc = ab.dot(ac);
    if (size == 3) {
        const double d3 = d1 - bb, d4 = d2 - bc, d5 = d1 - bc, d6 = d2 - cc; /* of b, and of c */
        const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2, all = va + vb + vc;
        if (va > 0.0 && vb > 0.0 && vc > 0.0 && all > 0.0) {
            share[1] = vb / all, share[2] = vc / all;
        } else { /* on the best of its edges */
            double best = INFINITY;
            for (int skip = 0; skip < 3; skip++) {
                const int edge[2] = {which[skip == 0 ? 1 : 0], which[skip == 2 ? 1 : 2]};
                double own[3];
                const double square = nearest_of(s, edge, 2, own);
                if (!(square < best)) continue;
                best = square, share[skip] = 0.0, share[skip == 0 ? 1 : 0] = own[0], share[skip == 2 ? 1 : 2] = own[1];
            }
            return best;
        }
    } else {
        share[1] = bb > 0.0 ? fmin(fmax(d1 / bb, 0.0), 1.0) : 0.0;
    }
    share[0] = 1.0 - share[1] - share[2];
    return (a + share[1] * ab + share[2] * ac).squaredNorm();
}

/* Whether the origin lies on the other side of the face opposite to a point of a tetrahedron. */
inline bool beyond_face(const Simplex &s, int opposite) {
    const int i = opposite == 0 ? 1 : 0, j = opposite <= 1 ? 2 : 1, k = opposite == 3 ? 2 : 3;
    const Vector3 &a = s.w[i], n = (s.w[j] - a).cross(s.w[k] - a);
    return !(n.dot(a) * n.dot(s.w[opposite] - a) < 0.0); /* a flat one has no inside */
}

/* The point v of the simplex that is nearest to the origin; points that it does not need are dropped. Its square, or 0
 * where the origin lies inside. */
inline double reduce(Simplex &s, Vector3 &v) {
    static const int every[4] = {0, 1, 2, 3};
    double best = INFINITY, share[4] = {0};
    if (s.size < 4) {
        best = nearest_of(s, every, s.size, share);
    } else {
        bool outside = false;
        for (int skip = 0; skip < 4; skip++) {
            if (!beyond_face(s, skip)) continue;
            const int face[3] = {skip == 0 ? 1 : 0, skip <= 1 ? 2 : 1, skip == 3 ? 2 : 3};
            double own[3];
            const double square = nearest_of(s, face, 3, own);
            outside = true;
            if (!(square < best)) continue;
            best = square, share[skip] = 0.0;
            for (int i = 0; i < 3; i++) share[face[i]] = own[i];
        }
        if (!outside) return 0.0;
    }
    int kept = 0;
    v.setZero();
    for (int i = 0; i < s.size; i++) {
        if (!(share[i] > 0.0)) continue;
        v += share[i] * s.w[i];
        s.w[kept] = s.w[i], s.b[kept] = s.b[i], s.share[kept++] = share[i];
    }
    s.size = kept;
    return best;
}

/* A lower bound of the distance of two shapes. `way`, a unit vector from the first to the second, is where the search
 * begins, and becomes that of the bound. It ends with a bound of `enough`, and with `tolerance` of what is left.
 * `point`, unless nullptr, becomes a point of the second shape that is nearest to the first; NaN if they touch. */
inline double least_gap(const Shape &first, const Shape &second, Vector3 &way, double enough, double tolerance, Vector3 *point) {
    const double radii = first.radius + second.radius;
    Simplex s;
    double best = -INFINITY;
    Vector3 n = way, v, near = Vector3::Constant(NAN);
    for (int i = 0; i < MOST_GJK; i++) {
        Vector3 &w = s.w[s.size], &b = s.b[s.size];
        b = farthest(second, -n);
        w = b - farthest(first, n);
        const double gap = n.dot(w) - radii;
        if (gap > best) best = gap, way = n;
        if (best >= enough) break;
        s.size++;
        const double size = sqrt(reduce(s, v));
        if (!(size > CORES_TOUCH)) break;
        n = v / size, near = -second.radius * n;
        for (int k = 0; k < s.size; k++) near += s.share[k] * s.b[k];
        if (size - radii - best <= GJK_FLOOR + tolerance * size || s.size == 4) break;
    }
    if (point) *point = near;
    return best;
}

#endif
