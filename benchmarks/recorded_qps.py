"""QPs of controllers, recorded in closed loops in both forms, and exported as a test set for qpbenchmark."""

from __future__ import annotations

import io
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import peer_cases

from coopqp import QPController, QPOptions
from coopqp.control import Constraints, PlainLoop, Proposal, StepProgram, VelocityBox
from coopqp.model import Chain
from coopqp.output import write_files
from coopqp.scenarios import Scenario, at_singularity, fast_lift
from coopqp.solvers import Outcome, QpProblem, QpSolver, Workspace, make_solver
from coopqp.spatial import Array

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
        base, B: map from the first unknowns to joint velocities, v = base + B x; the others are of joints led back.
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
        v: Array = self.base + self.B @ x[: self.B.shape[1]]
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


class Recorder(QpSolver):
    """DAQP that keeps a copy of every problem.

    Attributes:
        asked: the problems since the list was last emptied.
    """

    name = "recorder"

    def __init__(self) -> None:
        self._solver = make_solver("daqp")
        self.settings = self._solver.settings
        self.asked: list[QpProblem] = []

    def _solve(self, problem: QpProblem, work: Workspace) -> Outcome:
        self.asked.append(copied(problem))
        found = self._solver.solve(problem)
        return Outcome(found.status, found.x, None, found.iterations, found.message)

    def _forget(self) -> None:
        self._solver.reset()


class FormsOfStep:
    """What the two forms of a step's QP mean, from the step's own input."""

    def __init__(self, scenario: Scenario, options: QPOptions) -> None:
        self._cell, self._dt = scenario.cell, scenario.dt
        self._chain, self._box = Chain(scenario.cell, scenario.grasp), VelocityBox(scenario.cell)
        self._program = StepProgram(self._chain, options.weights)

    def of(self, proposal: Proposal, condensed: QpProblem, step: int) -> dict[str, RecordedQp]:
        """The QP that the step solved, and the full form beside it."""
        chain, box, given, terms = self._chain, self._box, proposal.given, proposal.found.terms
        middle = self._cell.moved(given.q, 0.5 * given.h * (2.0 * given.v - given.v_before))
        chain.linearise(middle, about=given.pose.translation)
        box.update(given.positions, given.v, given.h)
        _, base, B = self._program.condensed(terms, self._program.pieces(terms), box)
        J = np.linalg.inv(terms.to_world) @ chain.dense().reshape(chain.n_arms, 6, chain.nv)
        full = self._program.full(terms, box)
        still, only_v = np.zeros(chain.nv), np.eye(chain.nv, full.g.size)
        return {
            "condensed": RecordedQp(condensed, base, B, J, self._dt, step),
            "full": RecordedQp(full, still, only_v, J, self._dt, step),
        }


def record(case: str, arms: int, count: int) -> list[Recorded]:
    """``count`` successive QPs of a closed loop with a QP in every step, in each form.

    The loop is the plain definition of a step, and its solver records. Cases with an easy start are recorded around
    the first slowed step.
    """
    scenario = scenario_of(case, arms)
    first = _first_difficulty(scenario, count) if case in ("near_singular", "elbow") else 1
    recorder = Recorder()
    options = QPOptions(shortcut=False, solver=recorder, kernel="plain")
    none = Constraints(scenario.cell, ())
    loop = PlainLoop(scenario.cell, scenario.grasp, dt=scenario.dt, options=options, constraints=none)
    loop.follow(scenario.path)
    loop.start(scenario.q_start)
    loop.start_path()
    forms = FormsOfStep(scenario, options)
    found: dict[str, list[RecordedQp]] = {form: [] for form in FORMS}
    for number in range(first + count):
        recorder.asked.clear()
        proposal = loop.propose(loop.observe(None, None))
        if number >= first:  # the first step linearises more than once
            for form, qp in forms.of(proposal, recorder.asked[-1], number).items():
                found[form].append(qp)
        if loop.commit(proposal, time.perf_counter()).finished:
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
