/* The condensed QP of a step: v = base + columns x, x = [off-path twist (6), lost rate, lost shares of the grasp and path
 * corrections, null-space motions], each in the unit that makes its cost x². A least-distance problem. */

#include "functions.h"

/* Of one arm with n ≥ 6 joints: the right inverse P (n, 6) of least Σ (v/scale)², and a basis N (n, n − 6) of the self-
 * motions, orthonormal in the joints' units. By Householder's QR of diag(scale) Jᵀ. Returns 0 if near a singularity. */
static int right_inverse(const double *JT, const double *scale, int n, double *P, double *N) {
    double M[6 * MOST_JOINTS], Q[MOST_JOINTS * MOST_JOINTS], diagonal[6], largest = 0.0;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < 6; i++) M[6 * j + i] = scale[j] * JT[6 * j + i];
    for (int i = 0; i < 6; i++) {
        double square = 0.0;
        for (int j = i; j < n; j++) square += M[6 * j + i] * M[6 * j + i];
        double length = sqrt(square);
        if (!(length > 0.0 && isfinite(length))) return 0;
        diagonal[i] = M[6 * i + i] > 0.0 ? -length : length;
        M[6 * i + i] -= diagonal[i]; /* the reflector, of squared length 2 |d M_ii| */
        double per = -1.0 / (diagonal[i] * M[6 * i + i]);
        for (int m = i + 1; m < 6; m++) {
            double sum = 0.0;
            for (int j = i; j < n; j++) sum += M[6 * j + i] * M[6 * j + m];
            for (int j = i; j < n; j++) M[6 * j + m] -= sum * per * M[6 * j + i];
        }
    }
    memset(Q, 0, sizeof(double) * (size_t)(n * n)); /* row j: the j-th unit vector, reflected */
    for (int j = 0; j < n; j++) Q[n * j + j] = 1.0;
    for (int i = 0; i < 6; i++) {
        double per = -1.0 / (diagonal[i] * M[6 * i + i]);
        for (int j = 0; j < n; j++) {
            double sum = 0.0;
            for (int m = i; m < n; m++) sum += Q[n * j + m] * M[6 * m + i];
            for (int m = i; m < n; m++) Q[n * j + m] -= sum * per * M[6 * m + i];
        }
    }
    for (int j = 0; j < n; j++) {
        for (int i = 5; i >= 0; i--) { /* P = diag(scale) Q₁ R⁻ᵀ, row by row */
            double x = Q[n * j + i];
            for (int m = i + 1; m < 6; m++) x -= M[6 * i + m] * P[6 * j + m];
            P[6 * j + i] = x / diagonal[i];
        }
        for (int i = 0; i < 6; i++) {
            P[6 * j + i] *= scale[j];
            largest = fmax(largest, fabs(P[6 * j + i]));
            if (!isfinite(P[6 * j + i])) return 0;
        }
        for (int m = 6; m < n; m++) N[(n - 6) * j + m - 6] = scale[j] * Q[n * j + m];
    }
    return largest < LARGE_INVERSE;
}

/* Rows of base and columns of one arm; z is the first of its null-space unknowns, T the world twists of the object's six
 * directions, ν, c_k, c_p and b_k. */
static void arm_columns(Core *c, int k, int z, const double *P, const double *N, double T[10][6], double cap) {
    const int n = (int)c->arm_size[k], start = (int)c->arm_start[k], extra = n - 6, width = c->unknowns;
    const double *scale = c->scale + start, *wish = c->null_along + start, *offset = c->null_offset + start;
    double along[MOST_JOINTS], rest[MOST_JOINTS]; /* the wishes' coordinates in the null-space */
    for (int e = 0; e < extra; e++) {
        along[e] = rest[e] = 0.0;
        for (int j = 0; j < n; j++) {
            double per = N[extra * j + e] / (scale[j] * scale[j]);
            along[e] += per * wish[j];
            rest[e] += per * offset[j];
        }
    }
    for (int j = 0; j < n; j++) {
        double x[10], *row = c->columns + width * (start + j);
        for (int m = 0; m < 10; m++) {
            x[m] = 0.0;
            for (int i = 0; i < 6; i++) x[m] += P[6 * j + i] * T[m][i];
        }
        for (int e = 0; e < extra; e++) {
            x[6] += N[extra * j + e] * along[e];
            x[9] += N[extra * j + e] * rest[e];
        }
        memset(row, 0, sizeof(double) * (size_t)width);
        for (int m = 0; m < 6; m++) row[m] = x[m] * c->unit[m];
        for (int m = 6; m < 9; m++) row[m] = -x[m] * c->unit[m];
        for (int e = 0; e < extra; e++) row[z + e] = N[extra * j + e] * c->unit[z + e];
        c->base[start + j] = x[9] + x[7] + x[8] + cap * x[6];
    }
}

/* Fill base and columns, of joints and further rows. 0 where an arm is near a singularity, or a number is not finite. */
static int condense(Core *c, double cap) {
    double T[10][6], square = 0.0;
    int z = TWIST_AND_SHARES;
    for (int m = 0; m < 6; m++) {
        double one[6] = {};
        one[m] = 1.0;
        to_world(c->R, one, T[m]);
    }
    to_world(c->R, c->along, T[6]);
    to_world(c->R, c->path, T[8]);
    for (int j = 0; j < c->joints; j++) { /* joints that no arm moves stand still */
        c->base[j] = 0.0;
        memset(c->columns + c->unknowns * j, 0, sizeof(double) * (size_t)c->unknowns);
    }
    for (int k = 0; k < c->arms; k++) {
        const int n = (int)c->arm_size[k], start = (int)c->arm_start[k];
        double P[6 * MOST_JOINTS], N[MOST_JOINTS * MOST_JOINTS];
        to_world(c->R, c->grasp + 6 * k, T[7]);
        to_world(c->R, c->offsets + 6 * k, T[9]);
        if (!right_inverse(c->jacobian + 6 * start, c->scale + start, n, P, N)) return 0;
        arm_columns(c, k, z, P, N, T, cap);
        z += n - 6;
    }
    for (int r = 0; r < c->further_rows; r++) {
        double *row = c->columns + c->unknowns * (c->joints + r);
        c->base[c->joints + r] = further(c, r, c->base);
        memset(row, 0, sizeof(double) * (size_t)c->unknowns);
        for (int j = 0; j < c->joints; j++)
            for (int m = 0; m < c->unknowns; m++)
                row[m] += c->further[c->joints * r + j] * c->columns[c->unknowns * j + m];
    }
    for (int i = 0; i < c->joints + c->further_rows; i++) square += c->base[i] * c->base[i];
    for (int i = 0; i < c->unknowns * (c->joints + c->further_rows); i++) square += c->columns[i] * c->columns[i];
    return isfinite(square);
}

/* One row of the least-distance problem, scaled to unit norm: lower ≤ base + columns x − unit t ≤ upper, t unknown `slack`
 * (none for −1). */
static void put_row(const Core *c, int from, int width, int slack, double unit, double lower, double upper, double *row,
                    double *low, double *high) {
    const double *columns = c->columns + c->unknowns * from;
    double square = 0.0;
    for (int m = 0; m < c->unknowns; m++) square += columns[m] * columns[m];
    if (slack >= 0) square += unit * unit;
    const double per = square < 1e-24 ? 1.0 : 1.0 / sqrt(square);
    memset(row, 0, sizeof(double) * (size_t)width);
    for (int m = 0; m < c->unknowns; m++) row[m] = columns[m] * per;
    if (slack >= 0) row[slack] = -unit * per;
    *low = (lower - c->base[from]) * per;
    *high = (upper - c->base[from]) * per;
}

/* Solve the condensed QP by the core's own method. With `relax`, soft further rows may give way. Fills x and returns the
 * iterations, or a negative number. */
static int solve_condensed(Core *c, double cap, int relax) {
    const int rows = c->joints + c->further_rows;
    int outside = 0, n = c->unknowns, m = 0, soft = 0;
    for (int j = 0; j < c->joints; j++) outside += c->outside[j] != 0.0;
    for (int r = 0; relax && r < c->further_rows; r++) soft += c->further_soft[r] != 0.0;
    n += outside + soft;
    const int most = outside + rows;
    double *A = c->scratch, *low = A + n * most, *high = low + most, *lb = high + most, *ub = lb + n, *y = ub + n;
    for (int i = 0; i < n; i++) lb[i] = -INFINITY, ub[i] = INFINITY;
    for (int i = 6; i < 9; i++) lb[i] = 0.0, ub[i] = (i == 6 ? cap : 1.0) / c->unit[i];
    int slack = c->unknowns;
    for (int j = 0; j < c->joints; j++)
        if (c->outside[j] != 0.0) {
            put_row(c, j, n, slack++, c->options->recovery_unit, c->recovery[j], c->recovery[j], A + n * m, low + m,
                    high + m);
            m++;
        }
    for (int j = 0; j < c->joints; j++, m++)
        put_row(c, j, n, -1, 0.0, c->lower[j], c->upper[j], A + n * m, low + m, high + m);
    for (int r = 0; r < c->further_rows; r++, m++) {
        const int gives_way = relax && c->further_soft[r] != 0.0;
        put_row(c, c->joints + r, n, gives_way ? slack++ : -1, c->options->relax_unit * c->further_soft[r],
                c->further_lower[r], c->further_upper[r], A + n * m, low + m, high + m);
    }
    return least_distance(n, m, A, low, high, lb, ub, LARGEST_X, c->x, y, y + m + n);
}

/* The step that a solution stands for: command, rate, shares and off-path twist, and the limits at which it stands.
 * 0 if its excess over a limit is more than a solver's residue. */
static int read_answer(Core *c, double cap) {
    Proposal *p = c->proposal;
    int count = 0;
    for (int i = 0; i < c->joints; i++) {
        double v = c->base[i];
        for (int m = 0; m < c->unknowns; m++) v += c->columns[c->unknowns * i + m] * c->x[m];
        c->command[i] = v;
    }
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < c->joints + c->further_rows; i++) {
            const int own = i >= c->joints;
            const double v = own ? further(c, i - c->joints, c->command) : c->command[i];
            const double lower = own ? c->further_lower[i - c->joints] : c->lower[i];
            const double upper = own ? c->further_upper[i - c->joints] : c->upper[i];
            const double excess = pass ? lower - v : v - upper;
            const int soft = own && c->further_soft[i - c->joints] != 0.0;
            if (!(excess <= RESIDUE_TOLERANCE) && !(soft && p->relaxed != 0.0)) return 0;
            if (fabs(excess) > AT_LIMIT && !(own && excess > 0.0)) continue;
            c->bindings[2 * count] = i;
            c->bindings[2 * count++ + 1] = pass ? -1.0 : 1.0;
        }
    p->bindings = count;
    for (int j = 0; j < c->joints; j++) c->command[j] = clamp(c->command[j], c->lower[j], c->upper[j]);
    for (int i = 0; i < 6; i++) c->off_path[i] = c->x[i] * c->unit[i];
    p->new_rate = clamp(cap - c->x[6] * c->unit[6], 0.0, cap); /* a solver may miss its bounds a little */
    p->grasp_share = 1.0 - c->x[7] * c->unit[7];
    p->path_share = 1.0 - c->x[8] * c->unit[8];
    return 1;
}
