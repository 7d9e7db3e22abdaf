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

struct LeastDistance {
    int n, k;            /* unknowns, active rows */
    double *Q, *R;       /* (n, k) orthonormal, (k, k) triangular; both by columns of n numbers */
    double *w, *u;       /* of the active rows */
    double *d, *z, *r;   /* of the row that enters */
    int *active;         /* index of each active row: rows of A, then bounds of x */
};

static double ldp_dot(int n, const double *a, const double *b) {
    double part[4] = {0.0, 0.0, 0.0, 0.0};
    int i = 0;
    for (; i + 3 < n; i += 4)
        for (int j = 0; j < 4; j++) part[j] += a[i + j] * b[i + j];
    for (; i < n; i++) part[0] += a[i] * b[i];
    return (part[0] + part[1]) + (part[2] + part[3]);
}

static void ldp_add(int n, double factor, const double *a, double *sum) {
    for (int i = 0; i < n; i++) sum[i] += factor * a[i];
}

/* Split z into Q d + z; returns ‖z‖, 0 if that is rounding. Once more where much cancels: twice is enough. */
static double ldp_project(LeastDistance *s) {
    double before, after = ldp_dot(s->n, s->z, s->z);
    const double rounding = DEPENDENT * DEPENDENT * after;
    memset(s->d, 0, (size_t)s->k * sizeof(double));
    do {
        before = after;
        for (int j = 0; j < s->k; j++) {
            const double part = ldp_dot(s->n, s->Q + j * s->n, s->z);
            s->d[j] += part;
            ldp_add(s->n, -part, s->Q + j * s->n, s->z);
        }
        after = ldp_dot(s->n, s->z, s->z);
    } while (after < 0.5 * before && after > rounding);
    return s->k < s->n && after > rounding ? sqrt(after) : 0.0;
}

/* solution = R⁻¹ right */
static void ldp_solve(const LeastDistance *s, const double *right, double *solution) {
    memcpy(solution, right, (size_t)s->k * sizeof(double));
    for (int j = s->k - 1; j >= 0; j--) {
        solution[j] /= s->R[j * s->n + j];
        ldp_add(j, -solution[j], s->R + j * s->n, solution);
    }
}

static void ldp_rotate(int n, double c, double sine, double *a, double *b) {
    for (int i = 0; i < n; i++) {
        const double first = a[i];
        a[i] = c * first + sine * b[i];
        b[i] = c * b[i] - sine * first;
    }
}

/* Take out active row j: the columns of R move up, and rotations make it triangular again. */
static void ldp_drop(LeastDistance *s, int j) {
    const int n = s->n, last = --s->k;
    for (int i = j; i < last; i++) {
        memcpy(s->R + i * n, s->R + (i + 1) * n, (size_t)(i + 2) * sizeof(double));
        s->u[i] = s->u[i + 1], s->active[i] = s->active[i + 1];
    }
    for (int i = j; i < last; i++) {
        double *column = s->R + i * n;
        const double length = sqrt(column[i] * column[i] + column[i + 1] * column[i + 1]);
        const double c = column[i] / length, sine = column[i + 1] / length;
        for (int l = i; l < last; l++) ldp_rotate(1, c, sine, s->R + l * n + i, s->R + l * n + i + 1);
        ldp_rotate(n, c, sine, s->Q + i * n, s->Q + (i + 1) * n);
        ldp_rotate(1, c, sine, s->w + i, s->w + i + 1);
    }
}

/* y, where every active row has its side, takes the multipliers. */
static void ldp_multipliers(const LeastDistance *s, double *y) {
    for (int j = 0; j < s->k; j++) y[s->active[j]] *= s->u[j];
}

static int ldp_attempt(int n, int m, const double *A, const double *low, const double *high, const double *lb,
                       const double *ub, double reach, double tolerance, double *x, double *y, double *work) {
    LeastDistance s = {n, 0, work, work + n * n, nullptr, nullptr, nullptr, nullptr, nullptr, nullptr};
    s.w = s.R + n * n, s.u = s.w + n, s.d = s.u + n, s.z = s.d + n, s.r = s.z + n, s.active = (int *)(s.r + n);
    const int most = 100 + 4 * (n + m);
    memset(x, 0, (size_t)n * sizeof(double));
    memset(y, 0, (size_t)(m + n) * sizeof(double));
    for (int iterations = 0;; ) {
        /* The row that is broken most. */
        const double squared = ldp_dot(s.k, s.w, s.w); /* ‖x‖² */
        double worst = fmax(tolerance, ROW_ROUNDING * (1.0 + sqrt(squared))), sum = 0.0, side = 0.0, bound = 0.0;
        int p = -1;
        for (int i = 0; i < m + n; i++) {
            const double value = i < m ? ldp_dot(n, A + (size_t)i * (size_t)n, x) : x[i - m];
            const double lower = i < m ? low[i] : lb[i - m], upper = i < m ? high[i] : ub[i - m];
            sum += value; /* 0, before anything moves, unless A has entries that are not finite */
            if (value - upper > worst && y[i] == 0.0) worst = value - upper, p = i, side = 1.0, bound = upper;
            if (lower - value > worst && y[i] == 0.0) worst = lower - value, p = i, side = -1.0, bound = lower;
        }
        if (!isfinite(sum)) return -2;
        if (p < 0) {
            ldp_multipliers(&s, y);
            return iterations;
        }
        /* It enters. */
        double tau = 0.0, dual = 0.5 * squared;
        for (;;) {
            if (++iterations > most) return -2;
            memset(s.z, 0, (size_t)n * sizeof(double));
            if (p < m) ldp_add(n, -side, A + (size_t)p * (size_t)n, s.z);
            else s.z[p - m] = -side;
            const double length = ldp_project(&s), closed = -side * bound - ldp_dot(s.k, s.d, s.w);
            const double gap = closed - tau * length * length;
            ldp_solve(&s, s.d, s.r);
            double step = INFINITY;
            int first = -1;
            for (int j = 0; j < s.k; j++) {
                const int i = s.active[j];
                const int equality = i < m ? low[i] == high[i] : lb[i - m] == ub[i - m];
                if (!equality && s.r[j] > DEPENDENT && s.u[j] < step * s.r[j])
                    step = fmax(s.u[j] / s.r[j], 0.0), first = j;
            }
            if (length > 0.0 && gap <= step * length * length) {
                const int k = s.k++;
                for (int i = 0; i < n; i++) s.Q[k * n + i] = s.z[i] / length;
                memcpy(s.R + k * n, s.d, (size_t)k * sizeof(double));
                s.R[k * n + k] = length;
                s.w[k] = closed / length;
                s.active[k] = p, y[p] = side;
                ldp_solve(&s, s.w, s.u);
                memset(x, 0, (size_t)n * sizeof(double));
                for (int j = 0; j <= k; j++) ldp_add(n, s.w[j], s.Q + j * n, x);
                if (ldp_dot(s.k, s.w, s.w) <= reach * reach) break;
                ldp_multipliers(&s, y);
                return -1;
            }
            if (first >= 0) {
                ldp_add(s.k, -step, s.r, s.u);
                dual += step * (gap - 0.5 * step * length * length);
                tau += step;
            } else {
                for (int j = 0; j < s.k; j++) s.u[j] = -s.r[j];
                tau = 1.0;
            }
            if (first < 0 || dual > 0.5 * reach * reach) {
                ldp_multipliers(&s, y);
                y[p] = side * tau;
                return -1;
            }
            y[s.active[first]] = 0.0;
            ldp_drop(&s, first);
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
