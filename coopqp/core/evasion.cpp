/* Self-motion of redundant arms that keeps rows of distances: Evasion of nearby.h. */

#include <math.h>

#include "core.h"
#include "nearby.h"

void Evasion::add(const std::vector<double> &G, double lacks) {
    rows.insert(rows.end(), G.begin(), G.end());
    missing.push_back(lacks);
}

/* An orthonormal basis of what no column of A (n, 6) has a share in, by Householder's reflections: the last columns of Q. */
static void find_null_space(double (&A)[6][MOST_JOINTS], int n, double (&Z)[MOST_JOINTS][MOST_JOINTS]) {
    double scale[6];
    for (int k = 0; k < 6; k++) { /* each column becomes the vector of its reflection */
        double square = 0.0;
        for (int i = k; i < n; i++) square += A[k][i] * A[k][i];
        const double size = sqrt(square), own = square + fabs(A[k][k]) * size; /* half of the vector's square */
        A[k][k] += copysign(size, A[k][k]);
        scale[k] = own > 0.0 ? 1.0 / own : 0.0;
        for (int m = k + 1; m < 6; m++) {
            double along = 0.0;
            for (int i = k; i < n; i++) along += A[k][i] * A[m][i];
            along *= scale[k];
            for (int i = k; i < n; i++) A[m][i] -= along * A[k][i];
        }
    }
    for (int z = 0; z < n - 6; z++) {
        for (int i = 0; i < n; i++) Z[z][i] = i == 6 + z;
        for (int k = 5; k >= 0; k--) {
            double along = 0.0;
            for (int i = k; i < n; i++) along += A[k][i] * Z[z][i];
            along *= scale[k];
            for (int i = k; i < n; i++) Z[z][i] -= along * A[k][i];
        }
    }
}

/* An orthonormal basis of each redundant arm's self-motion, in units of its joints' speeds: of its joints that carry the tool. */
void Evasion::find_basis(Shapes &shapes, Read arm, Read carries, Read speeds) {
    const ptrdiff_t nv = arm.size;
    basis.clear();
    for (ptrdiff_t begin = 0, end; begin < nv; begin = end) {
        ptrdiff_t joint[MOST_JOINTS], n = 0;
        for (end = begin; end < nv && arm.data[end] == arm.data[begin]; end++)
            if (carries.data[end] != 0.0 && n < MOST_JOINTS) joint[n++] = end;
        if (n <= 6) continue;
        double scale[MOST_JOINTS], tool[6][MOST_JOINTS], still[MOST_JOINTS][MOST_JOINTS];
        for (ptrdiff_t i = 0; i < n; i++) {
            scale[i] = speeds.data[joint[i]] < FASTEST_JOINT ? speeds.data[joint[i]] : 1.0;
            const Vector6 &moved = shapes.twist((size_t)joint[i]); /* what each joint does to the tool */
            for (int k = 0; k < 6; k++) tool[k][i] = scale[i] * moved[k];
        }
        find_null_space(tool, (int)n, still);
        for (ptrdiff_t z = 0; z < n - 6; z++) {
            basis.resize(basis.size() + (size_t)nv);
            double *column = basis.data() + basis.size() - nv;
            for (ptrdiff_t i = 0; i < n; i++) column[joint[i]] = scale[i] * still[z][i];
        }
    }
}

/* min |z|² + |s|² with G (q′ + N z) + s / YIELDS >= lower: of rows that self-motion changes, with unit norm. */
void Evasion::move(Shapes &shapes, Read arm, Read carries, Read speeds, double *slope) {
    using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    using Numbers = Eigen::Map<Eigen::VectorXd>;
    find_basis(shapes, arm, carries, speeds);
    const ptrdiff_t nv = arm.size, motions = (ptrdiff_t)basis.size() / nv, all = (ptrdiff_t)missing.size();
    const Eigen::Map<const Eigen::MatrixXd> N(basis.data(), nv, motions);
    turned.resize((size_t)(all * motions));
    Eigen::Map<Rows> GN(turned.data(), all, motions);
    GN = Eigen::Map<const Rows>(rows.data(), all, nv).lazyProduct(N);
    helping.clear();
    for (ptrdiff_t i = 0; i < all && motions; i++)
        if (GN.row(i).cwiseAbs().maxCoeff() > HELPS) helping.push_back(i);
    const ptrdiff_t m = (ptrdiff_t)helping.size(), n = m + motions;
    if (!m) return;
    room.assign((size_t)(m * n + m + n + 3 * (m + n) + 2 * n * (n + 3)), 0.0);
    double *const matrix = room.data(), *const low = matrix + m * n, *const x = low + m, *const y = x + n;
    double *const lb = y + m + n, *const ub = lb + m + n, *const work = ub + m + n;
    Eigen::Map<Rows> A(matrix, m, n);
    for (ptrdiff_t i = 0; i < m; i++) {
        const auto row = GN.row(helping[(size_t)i]);
        const double per = 1.0 / sqrt(row.squaredNorm() + 1.0 / (YIELDS * YIELDS));
        A.row(i).head(motions) = per * row;
        A(i, motions + i) = per / YIELDS, low[i] = per * missing[(size_t)helping[(size_t)i]];
    }
    Numbers(lb, m + n).setConstant(-INFINITY), Numbers(ub, m + n).setConstant(INFINITY);
    if (best()->least_distance((int)n, (int)m, matrix, low, ub, lb, ub, INFINITY, x, y, work) < 0) return;
    Numbers(slope, nv) += N.lazyProduct(Numbers(x, motions));
}
