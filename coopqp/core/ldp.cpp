/* Least-distance programs,  min ½‖x‖²  subject to  low ≤ A x ≤ high,  lb ≤ x ≤ ub,  by the dual active-set method of
 * Goldfarb and Idnani (1983), from the origin.
 *
 * Every active row a is held at a bound β and pushes x along its normal: −a at an upper bound, a at a lower one. With
 * the normals as columns of N and their bounds, signed alike, in b, the least x is
 *
 *     N = Q R,    Rᵀ w = b,    x = Q w = N u,    R u = w,    multipliers u ≥ 0 (of any sign for equalities).
 *
 * A further row with normal ν enters with a multiplier τ that grows from 0, while the active rows stay at their bounds:
 *
 *     d = Qᵀ ν,   z = ν − Q d,   r = R⁻¹ d,   u(τ) = R⁻¹ w − τ r,   gap(τ) = β − dᵀ w − τ ‖z‖².
 *
 * It stands at its bound where the gap closes; a multiplier that vanishes before lets its own row go. The value of the
 * dual, ½‖x‖² wherever the gap is closed, grows all the while and is never above ½‖x‖² of a feasible x. So a value
 * above ½ reach² proves that no x up to `reach` is feasible; so does z = 0 where no row lets go.
 *
 * Rows are met to rounding where that leaves an answer, else, in a second attempt, to ROW_TOLERANCE. */

#define ROW_TOLERANCE 1e-10 /* a row (of unit norm) broken by less holds */
#define ROW_ROUNDING 1e-14  /* rounding of a row, as a share of 1 + ‖x‖ */
#define DEPENDENT 1e-14     /* ‖z‖ / ‖ν‖, and entries of r, up to this are rounding */

using Numbers = Eigen::Map<Eigen::VectorXd>;

/* In `work`, which has room for 2 n (n + 3) numbers. */
struct LeastDistance {
    int n, k = 0;                  /* unknowns, active rows */
    Eigen::Map<Eigen::MatrixXd> Q, R; /* k orthonormal columns; (k, k) triangular */
    Numbers w, u;                  /* of the active rows */
    Numbers d, z, r;               /* of the row that enters */
    int *active;                   /* index of each active row: rows of A, then bounds of x */

    LeastDistance(int unknowns, double *work)
        : n(unknowns), Q(work, n, n), R(work + n * n, n, n), w(R.data() + n * n, n), u(w.data() + n, n), d(u.data() + n, n),
          z(d.data() + n, n), r(z.data() + n, n), active(reinterpret_cast<int *>(r.data() + n)) {}

    /* Split z into Q d + z; returns ‖z‖, 0 if that is rounding. Once more where much cancels: twice is enough. */
    double project() {
        double before, after = z.squaredNorm();
        const double rounding = DEPENDENT * DEPENDENT * after;
        d.head(k).setZero();
        do {
            before = after;
            for (int j = 0; j < k; j++) {
                const double part = Q.col(j).dot(z);
                d[j] += part;
                z -= part * Q.col(j);
            }
            after = z.squaredNorm();
        } while (after < 0.5 * before && after > rounding);
        return k < n && after > rounding ? sqrt(after) : 0.0;
    }

    /* solution = R⁻¹ right */
    void solve(const Numbers &right, Numbers &solution) const {
        solution.head(k) = right.head(k);
        for (int j = k - 1; j >= 0; j--) {
            solution[j] /= R(j, j);
            solution.head(j) -= solution[j] * R.col(j).head(j);
        }
    }

    /* Take out active row j: the columns of R move up, and rotations make it triangular again. */
    void drop(int j) {
        const int last = --k;
        for (int i = j; i < last; i++) {
            R.col(i).head(i + 2) = R.col(i + 1).head(i + 2);
            u[i] = u[i + 1], active[i] = active[i + 1];
        }
        for (int i = j; i < last; i++) {
            const double length = sqrt(R(i, i) * R(i, i) + R(i + 1, i) * R(i + 1, i));
            const Eigen::JacobiRotation<double> rotation(R(i, i) / length, R(i + 1, i) / length);
            R.middleCols(i, last - i).applyOnTheLeft(i, i + 1, rotation);
            Q.applyOnTheRight(i, i + 1, rotation.transpose());
            w.applyOnTheLeft(i, i + 1, rotation);
        }
    }

    /* y, where every active row has its side, takes the multipliers. */
    void put_multipliers(double *y) const {
        for (int j = 0; j < k; j++) y[active[j]] *= u[j];
    }
};

static int ldp_attempt(int n, int m, const double *rows, const double *low, const double *high, const double *lb,
                       const double *ub, double reach, double tolerance, double *answer, double *y, double *work) {
    LeastDistance s(n, work);
    Numbers x(answer, n);
    const auto row = [&](int i) { return Given(rows + (size_t)i * (size_t)n, n); };
    const int most = 100 + 4 * (n + m);
    x.setZero(), Numbers(y, m + n).setZero();
    for (int iterations = 0;; ) {
        /* The row that is broken most. */
        const double squared = s.w.head(s.k).squaredNorm(); /* ‖x‖² */
        double worst = max_of(tolerance, ROW_ROUNDING * (1.0 + sqrt(squared))), sum = 0.0, side = 0.0, bound = 0.0;
        int p = -1;
        for (int i = 0; i < m + n; i++) {
            const double value = i < m ? row(i).dot(x) : x[i - m];
            const double lower = i < m ? low[i] : lb[i - m], upper = i < m ? high[i] : ub[i - m];
            sum += value; /* 0, before anything moves, unless A has entries that are not finite */
            if (value - upper > worst && y[i] == 0.0) worst = value - upper, p = i, side = 1.0, bound = upper;
            if (lower - value > worst && y[i] == 0.0) worst = lower - value, p = i, side = -1.0, bound = lower;
        }
        if (!isfinite(sum)) return -2;
        if (p < 0) {
            s.put_multipliers(y);
            return iterations;
        }
        /* It enters. */
        double tau = 0.0, dual = 0.5 * squared;
        for (;;) {
            if (++iterations > most) return -2;
            if (p < m) s.z = -side * row(p);
            else s.z = -side * Eigen::VectorXd::Unit(n, p - m);
            const double length = s.project(), closed = -side * bound - s.d.head(s.k).dot(s.w.head(s.k));
            const double gap = closed - tau * length * length;
            s.solve(s.d, s.r);
            double step = INFINITY;
            int first = -1;
            for (int j = 0; j < s.k; j++) {
                const int i = s.active[j];
                const int equality = i < m ? low[i] == high[i] : lb[i - m] == ub[i - m];
                if (!equality && s.r[j] > DEPENDENT && s.u[j] < step * s.r[j])
                    step = max_of(s.u[j] / s.r[j], 0.0), first = j;
            }
            if (length > 0.0 && gap <= step * length * length) {
                const int k = s.k++;
                s.Q.col(k) = s.z / length;
                s.R.col(k).head(k) = s.d.head(k);
                s.R(k, k) = length;
                s.w[k] = closed / length;
                s.active[k] = p, y[p] = side;
                s.solve(s.w, s.u);
                x.setZero();
                for (int j = 0; j <= k; j++) x += s.w[j] * s.Q.col(j);
                if (s.w.head(s.k).squaredNorm() <= reach * reach) break;
                s.put_multipliers(y);
                return -1;
            }
            if (first >= 0) {
                s.u.head(s.k) -= step * s.r.head(s.k);
                dual += step * (gap - 0.5 * step * length * length);
                tau += step;
            } else {
                s.u.head(s.k) = -s.r.head(s.k);
                tau = 1.0;
            }
            if (first < 0 || dual > 0.5 * reach * reach) {
                s.put_multipliers(y);
                y[p] = side * tau;
                return -1;
            }
            y[s.active[first]] = 0.0;
            s.drop(first);
        }
    }
}

static int least_distance(int n, int m, const double *A, const double *low, const double *high, const double *lb,
                          const double *ub, double reach, double *x, double *y, double *work) {
    for (int i = 0; i < m; i++)
        if (!(low[i] <= high[i])) return -2;
    for (int i = 0; i < n; i++)
        if (!(lb[i] <= ub[i])) return -2;
    const int code = ldp_attempt(n, m, A, low, high, lb, ub, reach, 0.0, x, y, work);
    return code >= 0 ? code : ldp_attempt(n, m, A, low, high, lb, ub, reach, ROW_TOLERANCE, x, y, work);
}
