"""QPs of controllers, recorded in closed loops, and exported as a test set for qpbenchmark."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import peer_cases

from coopqp import QPController, QPOptions
from coopqp.errors import StartWarning
from coopqp.model import Chain
from coopqp.output import write_files
from coopqp.scenarios import Scenario, at_singularity, fast_lift
from coopqp.solvers import Outcome, QpProblem, QpSolver, Stacked, make_solver
from coopqp.spatial import Array

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
    """Successive QPs of one case."""

    case: str
    arms: int
    qps: Sequence[RecordedQp]

    @property
    def name(self) -> str:
        return f"{self.case}_{self.arms}"


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
    """DAQP that keeps the last problem that it was asked."""

    name = "recorder"
    asked: QpProblem

    def __init__(self) -> None:
        self._solver = make_solver("daqp")
        self.settings = self._solver.settings

    def _solve(self, problem: QpProblem, rows: Stacked) -> Outcome:
        self.asked = problem
        found = self._solver.solve(problem)
        return Outcome(found.status, found.x, None, found.iterations, found.message)

    def _forget(self) -> None:
        self._solver.reset()


def record(case: str, arms: int, count: int) -> Recorded:
    """``count`` successive QPs of a closed loop with a QP in every step.

    The controller's solver records. Cases with an easy start are recorded around the first slowed step.
    """
    task = scenario_of(case, arms)
    first = _first_difficulty(task, count) if case in ("near_singular", "elbow") else 1
    recorder, chain = Recorder(), Chain(task.cell, task.grasp)
    options = QPOptions(shortcut=False, solver=recorder)
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StartWarning)  # some cases start there on purpose
        controller.reset(task.q_start)
    v = v_before = np.zeros(task.cell.nv)
    found: list[RecordedQp] = []
    for number in range(first + count):
        step = controller.step()
        if number >= first:  # the first step linearises more than once
            middle = task.cell.moved(step.q, 0.5 * step.dt * (2.0 * v - v_before))
            chain.linearise(middle, about=controller.reference.translation)
            to_object = np.kron(np.eye(2), controller.reference.rotation.T)
            J = to_object @ chain.dense().reshape(chain.n_arms, 6, chain.nv)
            found.append(RecordedQp(recorder.asked, *_velocity_map(controller), J, task.dt, number))
        if step.finished:
            break
        v, v_before = step.velocity, v
    return Recorded(case, arms, found)


def _velocity_map(controller: QPController) -> tuple[Array, Array]:
    """base (nv,) and B (nv, n) of the last QP, v = base + B x, which stay in the memory of the loop."""
    loop: Any = controller._loop
    nv, n = controller.cell.nv, loop.solver.program.units.size
    return loop.at["base"][:nv].copy(), loop.at["columns"][: nv * n].reshape(nv, n).copy()


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
