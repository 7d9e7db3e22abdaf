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
    double half[3] = {}, radius = 0.0; /* of a cylinder: radius, -, half of its length */
    double R0[9] = {}, p0[3] = {}, R[9] = {}, p[3] = {};
    std::vector<double> corners; /* of a hull */
};

/* The point of the core that is farthest along a direction. */
inline void farthest(const Shape &s, const double *way, double sign, double *point) {
    double d[3], at[3];
    for (int i = 0; i < 3; i++) d[i] = sign * (s.R[i] * way[0] + s.R[3 + i] * way[1] + s.R[6 + i] * way[2]);
    if (s.kind == BOX) {
        for (int i = 0; i < 3; i++) at[i] = d[i] < 0.0 ? -s.half[i] : s.half[i];
    } else if (s.kind == CYLINDER) {
        const double across = sqrt(d[0] * d[0] + d[1] * d[1]), share = across > 0.0 ? s.half[0] / across : 0.0;
        at[0] = share * d[0], at[1] = share * d[1], at[2] = d[2] < 0.0 ? -s.half[2] : s.half[2];
    } else {
        double most = -INFINITY;
        const double *best = s.corners.data();
        for (const double *c = best, *end = c + s.corners.size(); c < end; c += 3) {
            const double far = c[0] * d[0] + c[1] * d[1] + c[2] * d[2];
            if (far > most) most = far, best = c;
        }
        memcpy(at, best, sizeof at);
    }
    rotate(s.R, at, point);
    for (int i = 0; i < 3; i++) point[i] += s.p[i];
}

/* Up to four points b - a of two cores, the point b of each, and the shares of their nearest point to the origin. */
struct Simplex {
    int size = 0;
    double w[4][3], b[4][3], share[4];
};

/* Shares of the point of some of its points that is nearest to the origin, in `share`; its square. */
inline double nearest_of(const Simplex &s, const int *which, int size, double *share) {
    const double *a = s.w[which[0]];
    double ab[3], ac[3], v[3];
    share[0] = 1.0, share[1] = share[2] = 0.0;
    if (size == 1) return dot3(a, a);
    const double *b = s.w[which[1]], *c = s.w[which[size - 1]];
    for (int i = 0; i < 3; i++) ab[i] = b[i] - a[i], ac[i] = c[i] - a[i];
    const double d1 = -dot3(ab, a), bb = dot3(ab, ab), d2 = -dot3(ac, a), cc = dot3(ac, ac), bc = dot3(ab, ac);
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
    for (int i = 0; i < 3; i++) v[i] = a[i] + share[1] * ab[i] + (size == 3 ? share[2] * ac[i] : 0.0);
    return dot3(v, v);
}

/* Whether the origin lies on the other side of the face opposite to a point of a tetrahedron. */
inline bool beyond_face(const Simplex &s, int opposite) {
    const int i = opposite == 0 ? 1 : 0, j = opposite <= 1 ? 2 : 1, k = opposite == 3 ? 2 : 3;
    double u[3], v[3], n[3], to[3];
    for (int m = 0; m < 3; m++) {
        u[m] = s.w[j][m] - s.w[i][m], v[m] = s.w[k][m] - s.w[i][m], to[m] = s.w[opposite][m] - s.w[i][m];
    }
    n[0] = u[1] * v[2] - u[2] * v[1], n[1] = u[2] * v[0] - u[0] * v[2], n[2] = u[0] * v[1] - u[1] * v[0];
    return !(dot3(n, s.w[i]) * dot3(n, to) < 0.0); /* a flat one has no inside */
}

/* The point v of the simplex that is nearest to the origin; points that it does not need are dropped. Its square, or 0
 * where the origin lies inside. */
inline double reduce(Simplex &s, double *v) {
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
    v[0] = v[1] = v[2] = 0.0;
    for (int i = 0; i < s.size; i++) {
        if (!(share[i] > 0.0)) continue;
        memmove(s.w[kept], s.w[i], sizeof s.w[i]), memmove(s.b[kept], s.b[i], sizeof s.b[i]);
        s.share[kept] = share[i];
        for (int m = 0; m < 3; m++) v[m] += share[i] * s.w[kept][m];
        kept++;
    }
    s.size = kept;
    return best;
}

/* A lower bound of the distance of two shapes. `way`, a unit vector from the first to the second, is where the search
 * begins, and becomes that of the bound. It ends with a bound of `enough`, and with `tolerance` of what is left.
 * `point`, unless nullptr, becomes a point of the second shape that is nearest to the first; NaN if they touch. */
inline double least_gap(const Shape &first, const Shape &second, double *way, double enough, double tolerance,
                        double *point) {
    const double radii = first.radius + second.radius;
    Simplex s;
    double best = -INFINITY, n[3] = {way[0], way[1], way[2]}, v[3], near[3] = {NAN, NAN, NAN};
    for (int i = 0; i < MOST_GJK; i++) {
        double a[3], *w = s.w[s.size], *b = s.b[s.size];
        farthest(first, n, 1.0, a);
        farthest(second, n, -1.0, b);
        for (int m = 0; m < 3; m++) w[m] = b[m] - a[m];
        const double gap = dot3(n, w) - radii;
        if (gap > best) best = gap, memcpy(way, n, sizeof n);
        if (best >= enough) break;
        s.size++;
        const double size = sqrt(reduce(s, v));
        if (!(size > CORES_TOUCH)) break;
        for (int m = 0; m < 3; m++) n[m] = v[m] / size, near[m] = -second.radius * n[m];
        for (int k = 0; k < s.size; k++)
            for (int m = 0; m < 3; m++) near[m] += s.share[k] * s.b[k][m];
        if (size - radii - best <= GJK_FLOOR + tolerance * size || s.size == 4) break;
    }
    if (point) memcpy(point, near, sizeof near);
    return best;
}

#endif
