"""The control loop: a controller commands, a plant moves, a Recording stores the run."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp import planning
from coopqp.checks import ArrayLike, as_scalar, read_only
from coopqp.control.interface import Controller, ControlStep, Status
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.limits import BindingLimit
from coopqp.paths.moving_grasps import refuse_motion
from coopqp.paths.path import ObjectPath
from coopqp.paths.shifted import ShiftedPath
from coopqp.programs.program import Program
from coopqp.simulation.plants.kinematic import KinematicPlant, Plant
from coopqp.simulation.recording.notes import Notes
from coopqp.simulation.recording.recording import Recording, entries_of
from coopqp.simulation.recording.rows import Rows
from coopqp.simulation.recording.scene import describe_cell, describe_path
from coopqp.spatial import Array

#: Time until a run with a stopped object ends, by default [s].
PATIENCE = 1.0
#: Readings at rest whose mean the controller starts from.
_REST_SAMPLES = 100
#: An object off its path stands at a rate below this.
_STANDSTILL = 1e-3
#: Called during a run with the numbers of steps (done, total).
ProgressCallback = Callable[[int, int], None]


def simulate(
    controller: Controller,
    plant: Plant | None = None,
    *,
    q_start: ArrayLike | None = None,
    duration: float | None = None,
    settle: float = 0.0,
    loads: bool = False,
    patience: float | None = PATIENCE,
    progress: ProgressCallback | None = None,
    observe: Callable[[ControlStep], None] | None = None,
    operate: Callable[[Any, int], None] | None = None,
    metadata: dict[str, Any] | None = None,
) -> Recording:
    """Run a controller on a plant until the object reaches the end of its path.

    A run may be longer than the memory: its arrays go on in files without a name in the folder for temporary files
    (environment variable ``TMPDIR``), which end with the recording.

    Args:
        controller: the controller; it is reset at the plant's measured configuration. One with a true attribute
            ``needs_wrenches`` is asked as ``step(q, wrenches=…)``, as :class:`coopqp.ForceController` is.
        plant: the plant; by default an ideal :class:`KinematicPlant`.
        q_start: start configuration (nq,); by default :func:`coopqp.find_start` finds one.
        duration: longest run [s]; by default ten times the path's duration, because a slowed object takes longer.
        settle: time that the run continues after the end of the path [s].
        loads: record wrenches and torques of a plant that has them, as :class:`coopqp.simulation.PhysicsPlant`.
        patience: the run ends when the object was blocked, held, stopped or at rest off its path for this time [s];
            None for never. A pause does not count.
        progress: called as ``progress(steps done, steps of an unslowed run)``.
        observe: called with every :class:`ControlStep`.
        operate: called ahead of every step as ``operate(controller, steps done)``, for an operator's calls; those of
            :class:`coopqp.QPController` are recorded, see :mod:`coopqp.simulation.events`.
        metadata: entries stored in the recording; must be JSON.

    Raises:
        InvalidInputError: bad ``q_start`` or durations, the arms do not hold the object at the start, or a controller
            with ``needs_servos`` gets torque-controlled drives.
        NoStartError: no ``q_start`` is given and the search finds none.
    """
    for thing, methods, name in ((controller, ("reset", "step"), "controller"), (plant, ("reset", "apply"), "plant")):
        if thing is None and name == "plant":
            continue
        if isinstance(thing, type) or not all(callable(getattr(thing, method, None)) for method in methods):
            what = f"the class {thing.__name__} itself" if isinstance(thing, type) else f"a {type(thing).__name__}"
            raise InvalidInputError(what, f"simulate: {name}", f"Give an object with {' and '.join(methods)}.")
    cell: RobotCell = controller.cell
    plant = KinematicPlant(cell) if plant is None else plant
    refuse_for_plant(controller.path, plant)
    endless = not np.isfinite(controller.path.duration)
    if duration is None and endless:
        raise InvalidInputError("the path has no end", "simulate: duration", "Say how long to run [s].")
    longest = 10.0 * controller.path.duration if duration is None else as_scalar(duration, "simulate: duration")
    after = as_scalar(settle, "simulate: settle", open_low=False)
    enough = np.inf if patience is None else as_scalar(patience, "simulate: patience")
    try:
        json.dumps(metadata)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"not JSON ({error})", "simulate: metadata", "Give plain values.") from error
    if metadata is not None and not isinstance(metadata, dict):
        raise InvalidInputError(f"a {type(metadata).__name__}", "simulate: metadata", "Give a dictionary.")
    if q_start is None:
        q_start = planning.find_start(cell, controller.grasp, controller.path).q
    ask = _step_call(controller, plant)
    if loads and not hasattr(plant, "sensed_wrenches"):
        raise InvalidInputError(f"a {type(plant).__name__} has no forces", "simulate: loads", "Give a PhysicsPlant.")
    measured = begin(controller, plant, q_start)
    recorder = RunRecorder(controller, measured, plant if loads else None)
    nominal = max(1, round((longest if endless else controller.path.duration + after) / controller.dt))
    elapsed, rest, still = 0.0, 0.0, 0.0
    while elapsed < longest - 1e-9 * longest:
        if operate is not None:
            operate(controller, recorder.steps)
        step = ask(measured)
        measured = plant.apply(step)
        elapsed += step.dt
        recorder.take(step, measured)
        if observe is not None:
            observe(step)
        if progress is not None:
            progress(recorder.steps, nominal)
        if step.finished:
            if rest >= after - 1e-12:
                break
            rest += step.dt
        still = still + step.dt if _stands(step) else 0.0
        if still >= enough:
            break
    held = {"plant": type(plant).__name__, "gripped": getattr(plant, "gripped", None)}
    return recorder.recording({**held, "settle": after, "longest": longest, **(metadata or {})})


def refuse_for_plant(path: ObjectPath, plant: Any) -> None:
    """Refuse a path that a plant with grips cannot follow.

    Raises:
        InvalidInputError: arms let go or move on the object, and the grips of the plant stay closed; or a part opens,
            whose body is rigid in the plant.
    """
    where, motion = "simulate: plant", getattr(path, "grasps", None)
    if isinstance(plant, KinematicPlant) or not hasattr(plant, "grasp"):
        return
    if not getattr(plant, "follows_contact", False):
        refuse_motion(path, where, "Give a KinematicPlant: the grips of this one stay closed.")
    elif motion is not None and not motion.holding_fixed:
        raise InvalidInputError(
            "an arm moves on the object while it holds it, and the object is rigid", where, "Give a KinematicPlant."
        )


def begin(controller: Controller, plant: Plant, q_start: ArrayLike) -> Array:
    """Reset a plant, and the controller at the mean of what is measured at rest. Returns the first reading (nq,)."""
    measured = plant.reset(q_start)
    measure = getattr(plant, "measure", None)
    readings = [measured] if measure is None else [measured, *(measure() for _ in range(_REST_SAMPLES - 1))]
    cell: RobotCell = controller.cell
    controller.reset(cell.average(readings))  # noise averages out
    return measured


def _step_call(controller: Controller, plant: Plant) -> Callable[[Array], ControlStep]:
    """The call for a step of a controller; a force controller also gets the wrenches."""
    if not getattr(controller, "needs_wrenches", False):
        return controller.step
    wrenches: Callable[[], Array] | None = getattr(plant, "measured_wrenches", None)
    if wrenches is None:
        raise InvalidInputError(
            f"a {type(plant).__name__} has no force sensors", "simulate: plant", "Give a PhysicsPlant."
        )
    if getattr(controller, "needs_servos", False) and not getattr(plant, "servoed", True):
        raise InvalidInputError(
            f"a {type(controller).__name__} monitors forces through servos, not by torque-controlled drives",
            "simulate: plant",
            'Give PhysicsOptions(servo="position"), or the QPController without forces.',
        )
    step: Any = controller.step
    read = wrenches
    return lambda measured: step(measured, wrenches=read())


def _stands(step: ControlStep) -> bool:
    """Whether the object waits for something that its operator did not ask for."""
    if step.status is Status.OFF_PATH:
        return step.rate < _STANDSTILL
    return step.status in (Status.BLOCKED, Status.HOLDING, Status.FAULT)


def _phases_of(path: ObjectPath) -> list[dict[str, Any]]:
    """The phases of a program as plain data, also of one that an operator has shifted; none for other paths."""
    while isinstance(path, ShiftedPath):
        path = path.path
    return path.record() if isinstance(path, Program) else []


@final
class RunRecorder:
    """Gathers the steps of a run."""

    def __init__(self, controller: Controller, measured: Array, loaded: Any = None) -> None:
        cell = controller.cell
        self._controller: Any = controller
        self._loaded = loaded
        self._rows = {"time": Rows(), "clock": Rows(), "rate": Rows(), "status": Rows(), "reference": Rows(4, 4)}
        self._rows |= {"q": Rows(cell.nq), "q_command": Rows(cell.nq), "velocity": Rows(cell.nv)}
        self._follows = getattr(controller, "path", None) is not None and controller.path.grasps is not None
        if hasattr(controller, "shift") or self._follows:
            self._rows["shift"] = Rows(len(cell), 6)
        if loaded is not None:
            self._rows |= {"wrenches": Rows(len(cell), 6), "torques": Rows(cell.nv)}
        self.steps = 0
        self._now, self._failures, self._finished = 0.0, 0, False
        self._notes = Notes()
        self._binding: list[list[Any]] = []
        self._last: tuple[BindingLimit, ...] = ()
        self._append(time=0.0, q=measured)
        self._take_events: Callable[[], list[tuple[str, Any, float]]] = getattr(controller, "take_events", list)
        self._calls: list[list[Any]] = []
        self._begun = {name: getattr(controller, name, usual) for name, usual in (("override", 1.0), ("paused", False))}

    def take(self, step: ControlStep, measured: Array) -> None:
        """One more step, and the configuration measured after it."""
        if not self.steps:
            self._sample(step.q, step.clock)
        self._sample(step.q_next, step.clock_next)
        self._now += step.dt
        self._calls += [[self.steps, *event] for event in self._take_events()]
        self._append(time=self._now, q=measured)
        self._append(velocity=step.velocity, rate=step.rate, status=float(step.status.code))
        self._notes.take(step)
        if self._follows and step.path.grasps is not None:
            self._append(shift=self._moved(step.path.grasps.placements(step.clock_next)))
        elif "shift" in self._rows:
            self._append(shift=getattr(self._controller, "shift", np.zeros((len(self._controller.cell), 6))))
        if self._loaded is not None:
            self._append(wrenches=self._loaded.sensed_wrenches(), torques=self._loaded.joint_torques)
        if step.binding != self._last:
            self._binding.append([self.steps, [entries_of(limit) for limit in step.binding]])
            self._last = step.binding
        self._failures += step.status in (Status.HOLDING, Status.FAULT)
        self._finished = step.finished
        self.steps += 1

    def _moved(self, placements: Sequence[pin.SE3]) -> Array:
        """How far the tools have moved on the object (N, 6) [m, rad]: along the program, and where they give way."""
        shift = getattr(self._controller, "shift", None)
        if shift is not None:
            placements = [pin.exp6(d) * M for d, M in zip(shift, placements, strict=True)]
        return np.array([pin.log6(M).vector for M in placements])

    def _append(self, **rows: Any) -> None:
        """A row to each of some arrays, by name."""
        for name, row in rows.items():
            self._rows[name].append(row)

    def _sample(self, q_command: Array, clock: float) -> None:
        asked = getattr(self._controller, "asked_pose", None)  # by hand, elsewhere than on the path
        pose = asked or self._controller.path.pose(clock)
        self._append(q_command=q_command, clock=clock, reference=pose.homogeneous)

    def recording(self, metadata: dict[str, Any]) -> Recording:
        """The run so far.

        The entry ``binding`` is ``[step, [[arm, joint, kind], …]]`` for every step with other binding limits than the
        step before. A limit of a user's constraint has its name as a fourth entry.
        """
        controller, cell = self._controller, self._controller.cell
        arrays: dict[str, Any] = {name: rows.array() for name, rows in self._rows.items()}
        return Recording(
            **arrays,
            T_object_tool=read_only(np.array([X.homogeneous for X in controller.grasp.T_object_tool])),
            notes=self._notes.lines(),
            metadata={
                "controller": type(controller).__name__,
                "dt": controller.dt,
                "duration": controller.path.duration,
                "arms": list(cell.arm_names),
                "joints": list(cell.joint_names),
                "sources": [arm.source for arm in cell.arms],
                "scene": describe_cell(cell),
                "path": describe_path(controller.path),
                **({"phases": phases} if (phases := _phases_of(controller.path)) else {}),
                "binding": self._binding,
                "begun": self._begun,
                "calls": self._calls,
                "finished": self._finished,
                "failures": self._failures,
                **metadata,
            },
        )
