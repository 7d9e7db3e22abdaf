"""QPs of controllers, recorded in closed loops in both forms, and exported as a test set for qpbenchmark."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import peer_cases

from coopqp import Array, QPController, QPOptions, QpProblem
from coopqp.control import Pieces, StepTerms, VelocityBox
from coopqp.files import write_files
from coopqp.scenarios import Scenario, at_singularity, fast_lift

FORMS = ("condensed", "full")
#: Description of each case.
CASES = {
    "nominal": "arms round a ring, within all limits: no constraint is active",
    "saturated": "arms round a ring at 0.6 m/s, joints limited to 1 rad/s",
    "corner": "the paper's lift at 0.6 m/s, joints limited to 1 rad/s",
    "near_singular": "three arms, one of them 0.02 rad from the pole of its wrist",
    "elbow": "three arms, one of them on its way to a stretched elbow, to the stop",
    "outside": "three arms, one joint 10 mrad outside its limits at the start",
    "mismatch": "three arms, one of them 5 mm from its grasp at the start",
    "redundant": "arms of seven joints round a ring",
}
#: Largest number of steps to search for the difficult part of a case.
_SEARCH = 1500


@dataclass(frozen=True, eq=False)
class RecordedQp:
    """One QP of one step.

    Attributes:
        problem: the QP.
        base, B: map from the unknowns to joint velocities, v = base + B x.
        jacobians: Jacobian of each arm in the reference object frame, (6, nv) each.
        dt: length of the step [s].
        step: number of the step in the run.
    """

    problem: QpProblem
    base: Array
    B: Array
    jacobians: Array
    dt: float
    step: int

    def velocity(self, x: Array) -> Array:
        """Joint velocities of a solution [rad/s]."""
        v: Array = self.base + self.B @ x
        return v

    def chain_mm(self, dv: Array) -> float:
        """Largest distance to the first arm [mm] due to a velocity error ``dv`` in this step."""
        moved = self.jacobians @ dv * self.dt
        return float(1e3 * np.linalg.norm((moved - moved[0])[:, :3], axis=1).max())


@dataclass(frozen=True, eq=False)
class Recorded:
    """Successive QPs of one case in one form."""

    case: str
    arms: int
    form: str
    qps: Sequence[RecordedQp]

    @property
    def name(self) -> str:
        return f"{self.case}_{self.arms}_{self.form}"


def scenario_of(case: str, arms: int) -> Scenario:
    """The task of a case. Cases around a ring accept any number of arms."""
    if case in ("nominal", "saturated", "redundant"):
        path = "zigzag" if case == "saturated" else "nominal"
        return common.ring(arms=arms, joints=7 if case == "redundant" else 6, path=path)
    if case == "corner":
        return fast_lift(joint_speed=1.0)
    if case == "near_singular":
        return at_singularity("wrist", miss=0.02)
    if case == "elbow":
        return at_singularity("elbow")
    return peer_cases.build(case).scenario


def record(case: str, arms: int, count: int) -> list[Recorded]:
    """``count`` successive QPs of a closed loop with a QP in every step, in each form.

    Cases with an easy start are recorded around the first slowed step.
    """
    scenario = scenario_of(case, arms)
    first = _first_difficulty(scenario, count) if case in ("near_singular", "elbow") else 1
    options = QPOptions(shortcut=False, kernel="none")
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt, options=options)
    program, chain = controller._solver.program, controller._chain
    found: dict[str, list[RecordedQp]] = {form: [] for form in FORMS}
    condensed, number, wanted = program.condensed, 0, False

    def listen(terms: StepTerms, pieces: Pieces, box: VelocityBox) -> tuple[QpProblem, Array, Array]:
        problem, base, B = condensed(terms, pieces, box)
        if wanted:
            J = np.linalg.inv(terms.to_world) @ chain.dense().reshape(chain.n_arms, 6, chain.nv)
            full = program.full(terms, box)
            only_v = np.eye(chain.nv, full.g.size)
            for form, qp, start, columns in (
                ("condensed", copied(problem), base.copy(), B.copy()),
                ("full", full, np.zeros(chain.nv), only_v),
            ):
                found[form].append(RecordedQp(qp, start, columns, J, scenario.dt, number))
        return problem, base, B

    vars(program)["condensed"] = listen
    controller.reset(scenario.q_start)
    for number in range(first + count):  # listen() reads it
        wanted = number >= first
        if controller.step().finished:
            break
    return [Recorded(case, arms, form, found[form]) for form in FORMS]


def copied(problem: QpProblem) -> QpProblem:
    """A copy of the problem: the program overwrites its arrays in every step."""
    return QpProblem(**{field.name: getattr(problem, field.name).copy() for field in fields(QpProblem)})


def _first_difficulty(scenario: Scenario, count: int) -> int:
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt)
    controller.reset(scenario.q_start)
    for number in range(_SEARCH):
        step = controller.step()
        if step.rate < 0.99 or step.finished:
            return max(1, number - count // 4)
    return 1


# -- qpbenchmark -------------------------------------------------------------------------------------------------------

_TEST_SET = '''"""QPs of cooperating robot arms, recorded by coopqp, as a test set of qpbenchmark.

    pip install qpbenchmark daqp quadprog proxsuite osqp
    mkdir -p results && qpbenchmark cooperative_arms.py --results-path results/results.csv run --author NAME
"""

from pathlib import Path

import numpy as np
import qpbenchmark


class CooperativeArms(qpbenchmark.TestSet):
    """Every file in problems/ is one QP: P, q, G, h, A, b, lb, ub; what a problem has none of is left out."""

    @property
    def title(self):
        return "Cooperating robot arms"

    @property
    def description(self):
        return "QPs of one control step of 3 to 32 arms that hold one object, recorded in closed loops."

    @property
    def sparse_only(self):
        return False

    def __iter__(self):
        for file in sorted((Path(__file__).parent / "problems").glob("*.npz")):
            with np.load(file) as stored:
                data = {key: np.array(stored[key]) if key in stored else None for key in "P q G h A b lb ub".split()}
            yield qpbenchmark.Problem(**data, name=file.stem)
'''


def as_npz(problem: QpProblem) -> bytes:
    """A problem in the notation of qpsolvers: ½ xᵀ P x + qᵀ x, G x ≤ h, A x = b, lb ≤ x ≤ ub."""
    above, below = np.isfinite(problem.u), np.isfinite(problem.l)
    arrays: dict[str, Any] = {"P": problem.H, "q": problem.g, "lb": problem.lb, "ub": problem.ub}
    if above.any() or below.any():
        arrays["G"] = np.vstack([problem.C[above], -problem.C[below]])
        arrays["h"] = np.concatenate([problem.u[above], -problem.l[below]])
    if problem.b.size:
        arrays["A"], arrays["b"] = problem.A, problem.b
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def export(recorded: Sequence[Recorded], folder: Path, *, each: int = 3) -> list[Path]:
    """Write ``each`` evenly spaced problems of every recording, and the script for qpbenchmark."""
    contents = {folder / "cooperative_arms.py": _TEST_SET.encode()}
    for one in recorded:
        picked = np.unique(np.linspace(0, len(one.qps) - 1, each).round().astype(int)) if one.qps else ()
        for i in picked:
            contents[folder / "problems" / f"{one.name}_{one.qps[i].step:04}.npz"] = as_npz(one.qps[i].problem)
    return write_files(contents)
