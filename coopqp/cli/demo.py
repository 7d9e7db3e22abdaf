"""The command ``coopqp demo``: it runs, measures and draws the paper's lift with every method."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.baselines.pseudo_inverse import PseudoInverseController, PseudoInverseOptions
from coopqp.control.interface import NO_SOLVE, Controller, ControlStep
from coopqp.control.options import QPOptions
from coopqp.control.qp import QPController
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.output import json_bytes, write_files
from coopqp.scenarios import Scenario
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.evaluation.assessment import Tolerances, worst_status
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.simulate import simulate
from coopqp.solvers.choice import default_solver, make_solver
from coopqp.visualization import plots
from coopqp.visualization.joints import joint_figure
from coopqp.visualization.style import figure_bytes

#: Number of steps between the inverse-kinematics resets of ``pseudo_inverse_reset``.
RESET_EVERY = 10
#: Numbers of steps of the paper's Figure 5.
DEFAULT_STEPS = (40, 400, 1000)
#: The pictures of :func:`demo_pictures`.
PICTURES = ("paper_lift.png", "figure5.png", "figure5_orientation.png", "joints.png")
#: The solver that controllers use by default.
AUTO = "auto"

_VARIANTS = {
    "pseudo_inverse": PseudoInverseOptions(),
    "pseudo_inverse_literal": PseudoInverseOptions(increment="literal"),
    "pseudo_inverse_midpoint": PseudoInverseOptions(integration="midpoint"),
    "pseudo_inverse_reset": PseudoInverseOptions(reset_every=RESET_EVERY),
}
#: The methods, in the order of the demo.
METHODS = (*_VARIANTS, "qp")

#: Called as ``progress(method, steps, done)`` after every step of a run.
DemoProgress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class DemoRun:
    """A run of one method with one number of steps.

    Attributes:
        method: one of :data:`METHODS`.
        solver: name of the QP solver; "none" for the baseline.
        steps: N, the number of steps of an unslowed run.
        recording: the run.
        solved: number of steps that the QP solver solved.
        eps_p_mm, eps_o_deg: largest ε_p [mm] and ε_o [deg] of the run.
        object_error_mm: distance of A from its target at the end of the run [mm].
    """

    method: str
    solver: str
    steps: int
    recording: Recording
    solved: int
    eps_p_mm: float
    eps_o_deg: float
    object_error_mm: float

    @property
    def status(self) -> str:
        """``"ok"`` if every step tracked and the object arrived where it should, otherwise the worst status.

        ``"off target"`` where all steps tracked, but the object is further from its target than a run accepts.
        """
        worst = worst_status(self.recording)
        there = self.object_error_mm <= Tolerances().object_mm
        return worst if there or worst != "ok" else "off target"

    def record(self) -> dict[str, Any]:
        """The run as a flat record for JSON. Figures that are not finite become None."""
        figures = {name: getattr(self, name) for name in ("eps_p_mm", "eps_o_deg", "object_error_mm")}
        return {
            "method": self.method,
            "solver": self.solver,
            "steps": self.steps,
            **{name: value if math.isfinite(value) else None for name, value in figures.items()},
            "status": self.status,
        }


def check_demo(steps: Sequence[int], solver: str) -> tuple[int, ...]:
    """Check the demo's settings before a run. Returns the numbers of steps, sorted and without repetition.

    Raises:
        InvalidInputError: no number of steps, or a number below 1.
        UnknownNameError: no such solver.
        MissingExtraError: the solver's package is not installed.
    """
    if not steps or any(isinstance(n, bool) or not isinstance(n, int) or n < 1 for n in steps):
        raise InvalidInputError(f"steps are {list(steps)}", "demo: steps", "Give whole numbers ≥ 1.")
    if solver != AUTO:
        make_solver(solver)
    return tuple(sorted(set(steps)))


def run_method(
    scenario: Scenario, method: str, steps: int, *, solver: str = AUTO, progress: DemoProgress | None = None
) -> DemoRun:
    """Run one method on a scenario in ``steps`` steps and measure its errors.

    Raises:
        UnknownNameError: no such method or solver.
    """
    if method not in METHODS:
        raise UnknownNameError("method", method, METHODS)
    cell, grasp, path = scenario.cell, scenario.grasp, scenario.path
    dt = path.duration / steps
    controller: Controller
    if method == "qp":
        # Without the shortcut every step is a QP: the demo measures the solver.
        solver = default_solver() if solver == AUTO else solver
        options = QPOptions(solver=solver, shortcut=False)
        controller = QPController(cell, grasp, path, dt=dt, options=options)
    else:
        controller, solver = PseudoInverseController(cell, grasp, path, dt=dt, options=_VARIANTS[method]), "none"
    solved = 0

    def count(step: ControlStep) -> None:
        nonlocal solved
        solved += step.solver.name != NO_SOLVE.name

    recording = simulate(
        controller,
        q_start=scenario.q_start,
        progress=None if progress is None else lambda done, _: progress(method, steps, done),
        observe=count,
        metadata={"scenario": scenario.name, "method": method, "solver": solver, "steps": steps},
    )
    end = metrics.tool_placements(cell, recording.q[-1:])[0]
    return DemoRun(
        method=method,
        solver=solver,
        steps=steps,
        recording=recording,
        solved=solved,
        eps_p_mm=float(np.max(plots.relative_errors(cell, recording, "position"))),
        eps_o_deg=float(np.max(plots.relative_errors(cell, recording, "orientation"))),
        object_error_mm=1e3 * metrics.object_error(end, grasp, path.pose(path.duration))[0],
    )


def run_demo(
    scenario: Scenario,
    *,
    steps: Sequence[int] = DEFAULT_STEPS,
    solver: str = AUTO,
    progress: DemoProgress | None = None,
) -> list[DemoRun]:
    """Run every method with every number of steps. Errors as in :func:`check_demo`."""
    counts = check_demo(steps, solver)
    return [run_method(scenario, m, n, solver=solver, progress=progress) for m in METHODS for n in counts]


def demo_pictures(scenario: Scenario, runs: Sequence[DemoRun]) -> dict[str, bytes]:
    """The pictures by file name: the lift, Figure 5, ε_o, and the joints of the QP run with the most steps."""
    cell = scenario.cell
    curves = {
        label: [run.recording for run in runs if run.method == method]
        for method, label in (("pseudo_inverse", "pseudo-inverse"), ("qp", "QP"))
    }
    finest = max((run for run in runs if run.method == "qp"), key=lambda run: run.steps).recording
    figures = (
        plots.motion_figure(cell, finest, object_size=scenario.object_size, T_object_body=scenario.T_object_body),
        plots.error_figure(cell, curves),
        plots.error_figure(cell, curves, quantity="orientation"),
        joint_figure(cell, finest),
    )
    return {name: figure_bytes(figure) for name, figure in zip(PICTURES, figures, strict=True)}


def write_demo(
    scenario: Scenario, runs: Sequence[DemoRun], folder: str | Path | None, *, json_file: str | Path | None = None
) -> list[Path]:
    """Write the pictures into ``folder`` (None: no pictures) and the records to ``json_file``: all files, or none.

    Raises:
        OutputError: a folder or a file cannot be written.
        MissingExtraError: pictures need Matplotlib, which is not installed.
    """
    contents: dict[Path, bytes] = {}
    if folder is not None:
        contents = {Path(folder) / name: content for name, content in demo_pictures(scenario, runs).items()}
    if json_file is not None:
        contents[Path(json_file)] = json_bytes([run.record() for run in runs])
    return write_files(contents)
