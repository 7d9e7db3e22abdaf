/* Samples of straight lines between poses whose corners are rounded off, for walks of the arms: those of
 * `rounded` in coopqp/planning/route/sampling.py. */

#include <math.h>

#include <vector>

#include "spans.h"
#include "constants.h"
#include "rounded.h"
#include "spatial.h"

/* p = p_C + α e_0 + β e_1, R = R_C exp(α w_0) exp(β w_1); on a line α is the share of it, and β is 0. */
struct RoundedPiece {
    Pose T;
    Vector3 ways[2], turns[2];
    double length;
    bool bent;
};

struct RoundedLine {
    Pose T;
    Vector3 way, turn;
    double length;

    Pose pose(double share) const { return {T.R * exp3(share * turn), T.p + share * way}; }
};

/* α, β and their slopes at a share of a piece. */
struct RoundedPlace {
    double a, b, a_slope, b_slope;

    RoundedPlace(double share, bool bent) {
        const double x = 2.0 * share - 1.0, slope = 0.5 + x * (0.75 - 0.25 * x * x);
        b = bent ? RAMP_AT_MIDDLE + x * (0.5 + x * (3.0 / 8.0 - x * x / 16.0)) : 0.0;
        a = bent ? x - b : share;
        a_slope = bent ? 2.0 * (1.0 - slope) : 1.0, b_slope = bent ? 2.0 * slope : 0.0;
    }
};

/* How much of the shorter line's half a blend may take from both, so that it keeps within a deviation of the corner. */
static double cut_of(const RoundedLine &before, const RoundedLine &behind, double deviation) {
    const double apart = (behind.way / behind.length - before.way / before.length).norm() * RAMP_AT_MIDDLE;
    const double turned = (behind.turn / behind.length - before.turn / before.length).norm() * RAMP_AT_MIDDLE;
    double longest = 0.5 * minimum(before.length, behind.length);
    if (!(apart > NO_CORNER) && !(turned > NO_CORNER)) return 0.0;
    if (apart > NO_CORNER) longest = minimum(longest, deviation / apart);
    if (turned > NO_CORNER) longest = minimum(longest, deviation / TURN_LENGTH / turned);
    return longest;
}

static std::vector<RoundedPiece> pieces_of(Read poses, Read deviations) {
    const size_t count = (size_t)poses.size / 12 - 1;
    const Pose *const given = reinterpret_cast<const Pose *>(poses.data);
    std::vector<RoundedLine> lines;
    for (size_t i = 0; i < count; i++) {
        const Vector3 way = given[i + 1].p - given[i].p, turn = rotation_vector(given[i].R.transpose() * given[i + 1].R);
        lines.push_back({given[i], way, turn, sqrt(way.squaredNorm() + TURN_LENGTH * TURN_LENGTH * turn.squaredNorm())});
    }
    std::vector<double> cuts(count + 1, 0.0);
    for (size_t i = 1; i < count; i++) cuts[i] = cut_of(lines[i - 1], lines[i], deviations.data[i - 1]);
    std::vector<RoundedPiece> pieces;
    for (size_t i = 0; i < count; i++) {
        const RoundedLine &line = lines[i];
        const double left = line.length - cuts[i] - cuts[i + 1], half = cuts[i + 1];
        if (left > SHORTEST_LINE) {
            const double share = left / line.length;
            const Vector3 none = Vector3::Zero();
            pieces.push_back(
                {line.pose(cuts[i] / line.length), {share * line.way, none}, {share * line.turn, none}, left, false});
        }
        if (half > 0.0) {
            const RoundedLine &next = lines[i + 1];
            const double a = half / line.length, b = half / next.length;
            pieces.push_back(
                {line.pose(1.0), {a * line.way, b * next.way}, {a * line.turn, b * next.turn}, 2.0 * half, true});
        }
    }
    return pieces;
}

ptrdiff_t rounded(Read poses, Read deviations, Read settings, Write s, Write rows, Write motion) {
    check_fit(poses.size >= 24 && poses.size == 12 * (deviations.size + 2) && settings.size == 2 && s.size > 0);
    check_fit(rows.size == 12 * s.size && motion.size == 2 * (s.size - 1));
    const std::vector<RoundedPiece> pieces = pieces_of(poses, deviations);
    std::vector<ptrdiff_t> counts;
    ptrdiff_t total = 1;
    for (const RoundedPiece &piece : pieces) {
        const double steps = maximum(ceil(piece.length / settings.data[0]), settings.data[1]);
        check_fit(steps < 1e6, "the way is too long");
        counts.push_back((ptrdiff_t)steps);
        total += counts.back();
    }
    if (total > s.size) return total;
    double mark = 0.0;
    ptrdiff_t k = 0;
    const auto put = [&](const RoundedPiece &piece, const RoundedPlace &at, double along) {
        const Matrix3 R = piece.T.R * exp3(at.a * piece.turns[0]) * exp3(at.b * piece.turns[1]);
        reinterpret_cast<Pose *>(rows.data)[k] = {R, piece.T.p + at.a * piece.ways[0] + at.b * piece.ways[1]};
        s.data[k] = along;
    };
    for (size_t i = 0; i < pieces.size(); i++) {
        const RoundedPiece &piece = pieces[i];
        const double count = (double)counts[i];
        RoundedPlace at(0.0, piece.bent);
        for (ptrdiff_t j = 0; j < counts[i]; j++, k++) {
            put(piece, at, mark + (double)j / count * piece.length);
            const RoundedPlace next((double)(j + 1) / count, piece.bent);
            double *const moved = motion.data + 2 * k; /* α′ falls and β′ grows along a blend */
            moved[0] = (at.a_slope * piece.ways[0].norm() + next.b_slope * piece.ways[1].norm()) / count;
            moved[1] = (at.a_slope * piece.turns[0].norm() + next.b_slope * piece.turns[1].norm()) / count;
            at = next;
        }
        mark += piece.length;
        if (i + 1 == pieces.size()) put(piece, at, mark);
    }
    return total;
}
