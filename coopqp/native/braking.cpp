/* Rows that brake all arms together where no look-ahead does: coopqp/control/step/braking_rows.py. */

#include "functions.h"

/* Least eigenvalue of a symmetric 6 × 6 matrix, and its eigenvector, by Jacobi's rotations. */
static double least_by_rotations(double G[6][6], double *u) {
    double V[6][6] = {{0}}, trace = 0.0;
    int least = 0;
    for (int i = 0; i < 6; i++) V[i][i] = 1.0, trace += G[i][i];
    for (int sweep = 0; sweep < MOST_SWEEPS; sweep++) {
        double off = 0.0;
        for (int a = 0; a < 5; a++)
            for (int b = a + 1; b < 6; b++) {
                const double g = G[a][b];
                off = fmax(off, fabs(g));
                if (!(fabs(g) > SMALL_ROTATION * trace)) continue;
                const double half = 0.5 * (G[b][b] - G[a][a]) / g;
                const double t = copysign(1.0, half) / (fabs(half) + sqrt(half * half + 1.0));
                const double co = 1.0 / sqrt(t * t + 1.0), s = t * co;
                for (int i = 0; i < 6; i++) {
                    const double x = G[i][a], y = G[i][b], p = V[a][i], q = V[b][i];
                    G[i][a] = co * x - s * y, G[i][b] = s * x + co * y;
                    V[a][i] = co * p - s * q, V[b][i] = s * p + co * q;
                }
                for (int i = 0; i < 6; i++) {
                    const double x = G[a][i], y = G[b][i];
                    G[a][i] = co * x - s * y, G[b][i] = s * x + co * y;
                }
            }
        if (!(off > SMALL_ROTATION * trace)) break;
    }
    for (int i = 1; i < 6; i++)
        if (G[i][i] < G[least][least]) least = i;
    memcpy(u, V[least], sizeof V[least]);
    return fmax(G[least][least], 0.0);
}

/* The least singular value of one arm's tool Jacobian, from its rows of Jᵀ about a point `way` before the tool, and its
 * gradient over the arm's joints. */
static double singular_edge(const double *JT, const double *way, int n, double *gradient) {
    double near[6 * MOST_JOINTS], G[6][6], u[6], w[MOST_JOINTS], before[3] = {0}, after[3] = {0}, size = 0.0;
    for (int j = 0; j < n; j++) twist_at(JT + 6 * j, way, near + 6 * j);
    for (int i = 0; i < 6; i++)
        for (int m = 0; m <= i; m++) {
            double sum = 0.0;
            for (int j = 0; j < n; j++) sum += near[6 * j + i] * near[6 * j + m];
            G[i][m] = G[m][i] = sum;
        }
    least_by_rotations(G, u);
    for (int j = 0; j < n; j++) {
        w[j] = dot3(near + 6 * j, u) + dot3(near + 6 * j + 3, u + 3);
        size += w[j] * w[j];
    }
    size = sqrt(size);
    for (int j = 0; j < n; j++) w[j] /= size > 0.0 ? size : 1.0;
    /* uᵀ (∂_j J) w: a joint turns the joints after it, and those before it turn what it does */
    for (int j = n - 1; j >= 0; j--) {
        double lever[3];
        const double *linear = near + 6 * j, *turn = linear + 3;
        cross(linear, u, lever);
        for (int i = 0; i < 3; i++) after[i] += w[j] * lever[i];
        gradient[j] = dot3(turn, after);
        cross(turn, u + 3, lever);
        for (int i = 0; i < 3; i++) after[i] += w[j] * lever[i];
    }
    for (int j = 0; j < n; j++) {
        double moved[3];
        const double *linear = near + 6 * j, *turn = linear + 3;
        cross(before, linear, moved);
        gradient[j] += dot3(u, moved);
        for (int i = 0; i < 3; i++) before[i] += w[j] * turn[i];
    }
    return size;
}

/* J̇ v of one arm about a point that moves with the object. */
static void bend(const double *JT, const double *v, int n, double *out) {
    double before[3] = {};
    memset(out, 0, 6 * sizeof(double));
    for (int j = 0; j < n; j++) {
        const double *linear = JT + 6 * j, *turn = linear + 3;
        double twice[3], moved[3], turned[3];
        for (int i = 0; i < 3; i++) twice[i] = 2.0 * before[i] + v[j] * turn[i];
        cross(twice, linear, moved);
        cross(before, turn, turned);
        for (int i = 0; i < 3; i++) {
            out[i] += v[j] * moved[i], out[3 + i] += v[j] * turned[i];
            before[i] += v[j] * turn[i];
        }
    }
}

/* How fast an edge with this room may come closer, that does so at a speed s and that accelerations change by `most`. */
static double edge_speed(double room, double s, double most, double h, double T) {
    room = fmax(room, 0.0), s = fmax(s, 0.0);
    const double a = EDGE_SHARE * fmax(s, most * h) / T;
    const double stopping = sqrt(a * h * (a * h) + 2.0 * a * room) - a * h;
    return fmax(fmin(room / fmax(APPROACH_TIME, APPROACH_STEPS * h), stopping), (1.0 - h / T) * s);
}

/* The largest speed of a joint in this step. */
static double reachable(const Core *c, int j, double h) {
    const double speed = fabs(c->velocity[j]);
    return fmin(fmax(speed, fmin(c->speed[j], speed + c->acceleration[j] * h)), FASTEST_JOINT);
}

/* Add a row whose numbers are in place, if an admissible velocity could break it. */
static void add_row(Core *c, double lower, double upper, int number) {
    const int r = c->further_rows;
    c->further_lower[r] = lower, c->further_upper[r] = upper;
    c->further_soft[r] = GIVES_WAY, c->further_owner[r] = -1.0 - number;
    c->further_rows++;
}

static double *next_row(Core *c) {
    double *G = c->further + c->joints * c->further_rows;
    memset(G, 0, sizeof(double) * (size_t)c->joints);
    return G;
}

/* Where the tool of arm k is, from the object's origin as the first arm carries it. */
static void way_to_tool(const Core *c, int k, double *way) {
    const double *O = c->carried + 12 * k, *Y = c->object_R + 9 * k;
    double there[3], held[3];
    for (int i = 0; i < 3; i++) there[i] = c->tool_p[3 * k + i] - c->object_p[3 * k + i];
    rotate_back(Y, there, held);
    rotate(O, held, way);
    for (int i = 0; i < 3; i++) way[i] += O[9 + i] - c->carried[9 + i];
}

/* The limit that a row stands for, by its number in BrakingRows.labels: kind, arm, joint, constraint. */
static void name_brake(const Core *c, int number, double *entry) {
    const int arms = c->arms, joints = c->joints;
    const int joint = number < arms ? -1 : number < arms + joints ? number - arms : number - arms - joints;
    entry[0] = joint < 0 ? SINGULARITY : number < arms + joints ? POSITION : ACCELERATION;
    entry[1] = joint < 0 ? number : -1.0;
    entry[2] = joint;
    entry[3] = -1.0;
}

/* Add the rows that may bind the next velocities. */
static void brake_together(Core *c) {
    static const double still[6] = {};
    const double h = c->proposal->dt, *v = c->velocity;
    double T = h, *bends = c->scratch, *needed = bends + 6 * c->arms, *nothing = needed + c->joints, size = 0.0;
    int worst = 0;
    for (int j = 0; j < c->joints; j++) T = fmax(T, fabs(v[j]) / c->plan_acceleration[j]);
    carry_and_linearise(c, c->positions, c->carried + 9, nullptr, c->jacobian);
    memset(needed, 0, sizeof(double) * (size_t)c->joints);
    for (int k = 0; k < c->arms; k++) {
        const int n = (int)c->arm_size[k], start = (int)c->arm_start[k];
        double way[3], away[MOST_JOINTS], s = 0.0, most = 0.0, reach = 0.0, *G = next_row(c);
        way_to_tool(c, k, way);
        const double sigma = singular_edge(c->jacobian + 6 * start, way, n, away);
        for (int j = 0; j < n; j++) {
            G[start + j] = -away[j];
            s -= away[j] * v[start + j];
            most += fabs(away[j]) * c->plan_acceleration[start + j];
            reach += fabs(away[j]) * reachable(c, start + j, h);
        }
        const double upper = edge_speed(sigma - SINGULAR_MARGIN, s, most, h, T);
        if (reach > upper) add_row(c, -INFINITY, upper, k);
    }
    for (int j = 0; j < c->joints; j++) {
        const double x = c->positions[j], most = c->plan_acceleration[j];
        const double up = edge_speed(c->high[j] - x, v[j], most, h, T), down = edge_speed(x - c->low[j], -v[j], most, h, T);
        if (!(reachable(c, j, h) > fmin(up, down))) continue;
        next_row(c)[j] = 1.0;
        add_row(c, -down, up, c->arms + j);
    }
    for (int k = 0; k < c->arms; k++)
        bend(c->jacobian + 6 * (int)c->arm_start[k], v + (int)c->arm_start[k], (int)c->arm_size[k], bends + 6 * k);
    const int singular = !two_velocities(c, c->jacobian, bends, still, nullptr, nullptr, needed, nothing);
    double used = singular ? INFINITY : 0.0, reach = 0.0, *G = next_row(c);
    for (int j = 0; j < c->joints && !singular; j++) {
        const double share = fabs(needed[j]) / c->plan_acceleration[j];
        if (share > used) used = share, worst = j;
    }
    for (int j = 0; j < c->joints; j++) {
        const double speed = isfinite(c->speed[j]) ? c->speed[j] : 1.0;
        G[j] = v[j] / (speed * speed);
        size += G[j] * v[j];
    }
    size = sqrt(size);
    if (!(used > 0.5 * BEND_SHARE) || !(size > 0.0)) return;
    for (int j = 0; j < c->joints; j++) {
        G[j] /= size;
        reach += fabs(G[j]) * reachable(c, j, h);
    }
    const double upper = fmax(sqrt(BEND_SHARE / used), 1.0 - h / T) * size;
    if (reach > upper) add_row(c, -INFINITY, upper, c->arms + c->joints + worst);
}
