"""Mutants that change nothing, and why no test can see them."""

from __future__ import annotations

#: Stands for whichever module.
ANY = ""
#: Mutants that change nothing: module, line, mutated line (stripped), and why no test can see it.
EQUIVALENT: dict[tuple[str, str, str], str] = {
    (module, before, after): why
    for module, changes in {
        ANY: {
            ("@dataclass(eq=False)", "@dataclass(eq=True)"): "nobody compares these, and none of them is a key",
        },
        "coopqp/model/grasp.py": {
            (
                "if d > tolerance_m or a > tolerance_rad:",
                "if d > tolerance_m or a >= tolerance_rad:",
            ): "an angle of exactly the tolerance",
            (
                "if d > tolerance_m or a > tolerance_rad:",
                "if d >= tolerance_m or a > tolerance_rad:",
            ): "a distance of exactly the tolerance",
        },
        "coopqp/planning/knots.py": {
            (
                "_PASSES, _SETTLED = 60, 1e-11",
                "_PASSES, _SETTLED = 61, 1e-11",
            ): "it has settled long before",
            (
                "_LOOKS, _LEAST_IN_A_PIECE = 5, 11",
                "_LOOKS, _LEAST_IN_A_PIECE = 5, 12",
            ): "a knot more in each piece: a choice",
            (
                "uses = [np.abs(a.slope / arm.scale).max(axis=1) "
                "for a, arm in zip(self._coarse, self._arms, strict=True)]",
                "uses = [np.abs(a.slope / arm.scale).max(axis=1) "
                "for a, arm in zip(self._coarse, self._arms, strict=False)]",
            ): "there is one for each arm",
            (
                "if not np.isfinite(ahead).all():",
                "if not np.isfinite(ahead).any():",
            ): "where it is singular the arm ends in either case, and only its last knot is named",
        },
        "coopqp/collision/convex_shapes.py": {
            (
                'faces = np.ascontiguousarray(triangles, dtype="<i4").reshape(-1, 3)',
                'faces = np.ascontiguousarray(triangles, dtype="<i4").reshape(- 2, 3)',
            ): "NumPy reads any negative length as the one that fits",
        },
        "coopqp/files/cellfile/hints.py": {
            ("_ANY = 1e9", "_ANY = 1000000001.0"): "either internal force binds nothing",
        },
        "coopqp/control/step/contact.py": {
            (
                "if far > motion.attach_m or turned > motion.attach_rad:",
                "if far > motion.attach_m or turned >= motion.attach_rad:",
            ): "an angle of exactly the tolerance",
        },
        "coopqp/core/edges.cpp": {
            (
                "if (open[i] == last) std::swap(open[0], open[i]);",
                "if (open[i] == last) std::swap(open[1], open[i]);",
            ): "the order of asking; any pair that stops an edge may be named",
        },
        "coopqp/core/step.cpp": {
            ("entries[4 * count + 1] = -1.0;", ";"): "the arm is read only where it is written afterwards",
            (
                "if (!(kept->stride > 0.0) || --kept->left > 0.0 || "
                "!(kept->count >= 0.0 && kept->count < MOST_TRAVELS)) return;",
                "if (!(kept->stride > 0.0) || --kept->left > 0.0 || "
                "!(kept->count >= 0.0 || kept->count < MOST_TRAVELS)) return;",
            ): "the operator takes them before there are so many",
        },
        "coopqp/core/braking.cpp": {
            (
                "entry[1] = joint < 0 ? number : -1.0;",
                "entry[1] = joint < 0 ? number : -1.0 * 2;",
            ): "of a joint's row no arm is read",
        },
        "coopqp/core/program.cpp": {
            (
                "const double square = columns.squaredNorm() + (slack >= 0 ? unit * unit : 0.0);",
                "const double square = columns.squaredNorm() + (slack < 0 ? unit * unit : 0.0);",
            ): "a row that is scaled by another positive number is the same; rows without a slack have the unit 0",
            ("return 1;", "return 2;"): "asked for as yes or no",
        },
        "coopqp/core/paths.cpp": {
            (
                "const Place share = on_law((at - shift[0]) / span, 1.0, 0.0, span);",
                "const Place share = on_law((at - shift[0]) / span, 1.0, 2.0, span);",
            ): "only the law of even acceleration has a speed at the start",
            (
                "const double *last = c->path_numbers + 3 + count_of(c, 1) + SEGMENT * (count_of(c, 2) - 1);",
                "const double *last = c->path_numbers - 3 + count_of(c, 1) + SEGMENT * (count_of(c, 2) - 1);",
            ): "only segments are compared with it, which are 29 numbers apart",
        },
        "coopqp/core/residual.cpp": {
            (
                "const auto scratch = [&](int i) { return Twists(c->scratch + 6 * i * c->arms, 6, c->arms); };",
                "const auto scratch = [&](int i) { return Twists(c->scratch + 6 * i * c->arms, 7, c->arms); };",
            ): "the number of rows is part of the type",
        },
        "coopqp/core/watch.cpp": {
            (
                "const auto scratch = [&](int i) { return Twists(c->scratch + 6 * i * c->arms, 6, c->arms); };",
                "const auto scratch = [&](int i) { return Twists(c->scratch + 7 * i * c->arms, 6, c->arms); };",
            ): "there is room to leave some",
            (
                "return finite && away.allFinite();",
                "return finite || away.allFinite();",
            ): "steps and positions that are not finite are refused before",
        },
        "coopqp/core/kinematics.cpp": {
            ("if (!(d2 < 2.5e-3)) {", "if (!(d2 < 2.5e-3 * 2)) {"): "the series are as exact as rounding there, too",
        },
        "coopqp/core/nearby.cpp": {
            (
                "if (count++ == 2 * SHARPENED_EARLY) return true;",
                "if (count++ == 3 * SHARPENED_EARLY) return true;",
            ): "how many pairs a step looks at: a choice",
            (
                "for (size_t j = 0; j < coming.size(); j++) way[j] = WIDER * fabs(coming[j]);",
                "for (size_t j = 0; j < coming.size(); j++) way[j] = WIDER / fabs(coming[j]);",
            ): "how early pairs are looked at: a choice",
        },
        "coopqp/core/chain_ahead.cpp": {
            ("k->corner = 1.0;", "k->corner = 1.0 * 2;"): "asked for as yes or no",
            (
                "return {reinterpret_cast<Pose *>(c->sketch), {errors, 6, n}, "
                "{errors + 6 * n, 6, n}, {jacobian, 6, nv},",
                "return {reinterpret_cast<Pose *>(c->sketch), {errors, 6, n}, "
                "{errors + 6 * n, 6, n}, {jacobian, 7, nv},",
            ): "the number of rows is part of the type",
            (
                "const int n = Symmetric::RowsAtCompileTime < 0 ? (int)G.rows() : Symmetric::RowsAtCompileTime;",
                "const int n = Symmetric::RowsAtCompileTime < 1 ? (int)G.rows() : Symmetric::RowsAtCompileTime;",
            ): "the number of rows is negative where it is not known, and at least 1 where it is",
        },
        "coopqp/paths/certificate.py": {
            (
                "return answer.q, np.empty((len(guess), 0, 6)), answer.residual <= exact",
                "return answer.q, np.empty((len(guess), 0, 6)), answer.residual < exact",
            ): "a miss of exactly the tolerance",
        },
        "coopqp/planning/phase_checks.py": {
            (
                "if until < span.start - _END:",
                "if until <= span.start - _END:",
            ): "a time of exactly the tolerance before",
        },
        "coopqp/studies/placing.py": {
            (
                "least, pair, at = np.inf, 0, 0",
                "least, pair, at = np.inf, 0, 1",
            ): "the distance at the first sample is smaller than infinity",
        },
        "coopqp/simulation/plants/physics.py": {
            (
                "palms=None if self.palms is None else dict(zip(cell.arm_names, self.palms, strict=True)),",
                "palms=None if self.palms is None else dict(zip(cell.arm_names, self.palms, strict=False)),",
            ): "as many palms as arms were asked for before",
        },
    }.items()
    for (before, after), why in changes.items()
}
