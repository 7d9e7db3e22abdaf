"""The paper's lift in a physics engine, in newtons: the forces due to ε_p and to the errors of a real cell.

All forces act in welds between tool and plate. They are proportional to the stated servo stiffness. ΔF is the force at
a grasp minus the force in a reference run with exact inverse kinematics at every step of the engine; records contain
its maximum over grasps and time. There are three groups of records (key ``group``):

``replay``  commands of both controllers for N steps, replayed with a quintic time warp of the same q(τ);
``loop``    ``simulate`` with the engine as the plant and feedback of the measured state;
``real``    the loop with disturbances for 12 s: a lift of 3 s, then a hold.
"""

from __future__ import annotations

import argparse
import io
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin

from coopqp import (
    ControlStep,
    Grasp,
    QPController,
    QPOptions,
    Recording,
    Status,
    SupervisionOptions,
    simulate,
)
from coopqp.baselines import PseudoInverseController, PseudoInverseOptions
from coopqp.control import Controller
from coopqp.forces import StressModel, at_tools
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario, paper_lift
from coopqp.simulation import (
    Disturbances,
    Interpolation,
    Motion,
    PhysicsOptions,
    PhysicsPlant,
    Replay,
    exact_motion,
    misplaced,
    recorded_motion,
    relative_positioning_error,
    tool_placements,
)
from coopqp.spatial import Array

PSEUDO_INVERSE, QP = "pseudo-inverse", "qp"
ENGINE_STEP = 1e-3
#: Time that the loop continues after the lift [s].
HOLD = 9.0
#: Errors of 1 mm and 0.1°, and of 2 mm, along and about the same diagonal.
DIAGONAL = np.ones(3) / np.sqrt(3.0)
BASE_OFF = pin.SE3(pin.exp3(np.deg2rad(0.1) * DIAGONAL), 1e-3 * DIAGONAL)
GRIP_OFF = pin.SE3(np.eye(3), 2e-3 * DIAGONAL)
#: Force from servo deflection at which a robot could raise an alarm [N]; in this lift inertia alone gives 23 N.
ALARM = 300.0
#: Supervision that tolerates a measured spread of millimetres, here due to displaced bases and grips.
TOLERANT = SupervisionOptions(slow_from=0.005, hold_from=0.01)


@dataclass(frozen=True)
class Run:
    """One run in the engine.

    Attributes:
        wrenches: wrenches on the object at each step in the object frame (T, N, 6) [N, N·m].
        recording: recording of the loop.
    """

    wrenches: Array
    recording: Recording

    def added(self, reference: Run) -> Array:
        """Wrenches at the grasps minus the reference's (T, N, 6), in the tools' axes."""
        n = min(len(self.wrenches), len(reference.wrenches))
        grasp = self.recording.grasp
        return np.array([at_tools(w, grasp) for w in self.wrenches[:n] - reference.wrenches[:n]])


def watch(controller: Controller, plant: PhysicsPlant, scenario: Scenario, *, settle: float = 0.2) -> Run:
    """Run a controller on the engine and read the wrenches after every step."""
    wrenches: list[Array] = []
    longest = scenario.path.duration + settle + 1.0
    recording = simulate(
        controller,
        plant,
        q_start=scenario.q_start,
        settle=settle,
        duration=longest,
        observe=lambda _: wrenches.append(plant.wrenches()),
    )
    return Run(np.array(wrenches), recording)


def force(added: Array) -> Array:
    """Largest force at any grasp (T,) [N]."""
    return np.asarray(np.linalg.norm(added[:, :, :3], axis=2).max(axis=1))


def controller(kind: str, scenario: Scenario, *, dt: float, grasp: Grasp | None = None, **options: Any) -> Controller:
    """Build a controller by name for a scenario."""
    held = scenario.grasp if grasp is None else grasp
    if kind == QP:
        return QPController(scenario.cell, held, scenario.path, dt=dt, options=QPOptions(**options))
    return PseudoInverseController(scenario.cell, held, scenario.path, dt=dt, options=PseudoInverseOptions())


# -- replays -----------------------------------------------------------------------------------------------------------


class Replays:
    """Joint motions of the lift, replayed with a quintic time warp, one command per step of the engine."""

    def __init__(self, scenario: Scenario, interpolation: Interpolation) -> None:
        self.scenario, self.interpolation = scenario, interpolation
        self.plant = PhysicsPlant.of(scenario, options=PhysicsOptions(interpolation=interpolation))
        s = scenario
        self.reference = self.play(exact_motion(s.cell, s.grasp, s.path, s.q_start))

    def play(self, motion: Motion) -> Run:
        """Replay one motion."""
        s = self.scenario
        replay = Replay(s.cell, s.grasp, s.path, motion, dt=ENGINE_STEP, time_law=TimeLaw.QUINTIC)
        return watch(replay, self.plant, s)

    def record(self, kind: str, steps: int) -> tuple[common.Record, dict[str, Array]]:
        """Figures of one controller and N, and its curves: time [s], ΔF [N], ε_p [mm], estimate [N]."""
        s = self.scenario
        commands = simulate(controller(kind, s, dt=s.path.duration / steps), q_start=s.q_start)
        run = self.play(recorded_motion(s.cell, commands, interpolation=self.interpolation))
        every = 10
        added = run.added(self.reference)
        total, pressed = force(added), added[::every]
        q = run.recording.q_command[1::every]
        measure = np.array([1e3 * relative_positioning_error(T, s.grasp) for T in tool_placements(s.cell, q)])
        model = StressModel(s.cell, s.grasp, stiffness=self.plant.stiffness)
        estimate = np.array([at_tools(w, s.grasp) for w in model.history(q)])
        error = force(estimate - pressed)
        at_rest = [
            at_tools(model.from_servos(r.recording.q_command[-1], r.recording.q[-1]), s.grasp)
            for r in (run, self.reference)
        ]
        servos = np.linalg.norm((at_rest[0] - at_rest[1] - added[-1])[:, :3], axis=1).max()
        baseline = kind == PSEUDO_INVERSE
        record = {
            "group": "replay",
            "controller": kind,
            "N": steps,
            "interpolation": self.interpolation,
            "eps_p_mm": float(measure.max()),
            "delta_force_N": float(total.max()),
            "delta_torque_Nm": float(np.linalg.norm(added[:, :, 3:], axis=2).max()),
            # Only in runs of the baseline is the force proportional to ε_p; in others only inertia remains.
            "force_per_mm": float(total[-1] / measure[-1]) if baseline else None,
            "correlation": float(np.corrcoef(total[::every], measure)[0, 1]) if baseline else None,
            "estimate_error": float(error.max() / total.max()) if baseline else None,
            "estimate_error_at_rest": float(error[-1] / total.max()) if baseline else None,
            "servo_reading_error_N": float(servos),
        }
        curves = {"time": run.recording.time[1::every], "force": total[::every], "eps": measure, "est": force(estimate)}
        return record, curves


# -- the loop ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A disturbance.

    Attributes:
        name: name of the case.
        base, grip: placement errors of the bases and the grips, by arm.
        other: further disturbances.
        latched: True if the grasp is latched from the measured configuration before the start; None if not relevant.
        options: options of the controller besides the defaults.
        tolerant: use the thresholds :data:`TOLERANT` in place of the defaults.
        watched: the controller knows the servos' stiffness and holds at its default force limit.
    """

    name: str
    base: dict[str, pin.SE3]
    grip: dict[str, pin.SE3]
    other: dict[str, Any]
    latched: bool | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    tolerant: bool = False
    watched: bool = False


def geometry_cases(arm: str, name: str = "", offsets: dict[str, pin.SE3] | None = None) -> Iterator[Case]:
    """Cases with an error of one arm's base or grip, with and without latching."""
    for latched in (True, False):
        for what, off in (offsets or {"base 1 mm + 0.1°": BASE_OFF, "grip 2 mm": GRIP_OFF}).items():
            base, grip = ({arm: off}, {}) if what.startswith("base") else ({}, {arm: off})
            yield Case(f"{what}, {arm}{name}", base, grip, {}, latched, tolerant=True)


def direction_cases() -> Iterator[Case]:
    """Cases with a base error in one direction each, for the range of forces."""
    for arm in ("master", "slave_1", "slave_2"):
        offsets = {}
        for i, axis in enumerate("xyz"):
            unit = np.eye(3)[i]
            offsets[f"base 1 mm along {axis}"] = pin.SE3(np.eye(3), 1e-3 * unit)
            offsets[f"base 0.1° about {axis}"] = pin.SE3(pin.exp3(np.deg2rad(0.1) * unit), np.zeros(3))
            offsets[f"grip 2 mm along {axis}"] = pin.SE3(np.eye(3), 2e-3 * unit)
        yield from geometry_cases(arm, offsets=offsets)


def signal_cases() -> Iterator[Case]:
    """Cases with disturbed encoders, timing and servos, under the default supervision."""
    yield Case("none", {}, {}, {})
    for noise in (1e-4, 1e-3):
        yield Case(f"encoder noise {noise:g} rad", {}, {}, {"encoder_noise": noise})
    yield Case("encoder noise 0.0001 rad, path gain 2 1/s", {}, {}, {"encoder_noise": 1e-4}, options={"path_gain": 2.0})
    for latency in (0.002, 0.005, 0.01):
        yield Case(f"latency {1e3 * latency:g} ms", {}, {}, {"latency": latency})
    yield Case("5 % of samples lost", {}, {}, {"drop_share": 0.05, "drops_by_arm": True})
    yield Case("dt ± 20 %", {}, {}, {"dt_jitter": 0.2})
    yield Case("slave_1 lags by 10 ms", {}, {}, {"lag": {"slave_1": 0.01}})
    for watched in (False, True):
        name = "slave_1 stalls at 1.2 s" + (", servos watched" if watched else "")
        yield Case(name, {}, {}, {"stall": {"slave_1": 1.2}}, watched=watched)


class Jittered:
    """A controller with the varying periods of the plant."""

    def __init__(self, inner: Controller, plant: PhysicsPlant) -> None:
        self.cell, self.grasp, self.path, self.dt = inner.cell, inner.grasp, inner.path, inner.dt
        self._inner, self._plant = inner, plant

    def reset(self, q: Any) -> None:
        self._inner.reset(q)

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        return self._inner.step(q_measured, dt=self._plant.period(self.dt))


class Loop:
    """The quintic lift with feedback from the engine's encoders."""

    def __init__(self, scenario: Scenario, *, dt: float, hold: float) -> None:
        self.scenario, self.dt, self.hold = scenario, dt, hold
        s = scenario
        exact = Replay(s.cell, s.grasp, s.path, exact_motion(s.cell, s.grasp, s.path, s.q_start), dt=dt)
        self.reference = watch(exact, PhysicsPlant.of(s), s, settle=hold)

    def nominal(self, kind: str) -> common.Record:
        """One controller without disturbances."""
        run = watch(controller(kind, self.scenario, dt=self.dt), PhysicsPlant.of(self.scenario), self.scenario)
        return {
            "group": "loop",
            "controller": kind,
            "N": round(self.scenario.path.duration / self.dt),
            "delta_force_N": float(force(run.added(self.reference)).max()),
            "finished": run.recording.finished,
            "failures": int(run.recording.metadata["failures"]),
        }

    def case(self, case: Case) -> tuple[common.Record, Array]:
        """The record of the QP controller under one disturbance, and its force over time (T, 2) [s, N]."""
        s = self.scenario
        disturbances = Disturbances(**case.other, base_offset=case.base)
        plant = PhysicsPlant.of(s, real_grasp=misplaced(s.cell, s.grasp, case.grip), disturbances=disturbances)
        grasp = s.grasp
        if case.latched:
            grasp = Grasp.from_configuration(s.cell, plant.reset(s.q_start), nominal=s.grasp)
        options = dict(case.options) | ({"supervision": TOLERANT} if case.tolerant else {})
        if case.watched:
            options["supervision"] = SupervisionOptions(stiffness=tuple(plant.stiffness))
        made = controller(QP, s, dt=self.dt, grasp=grasp, **options)
        jittered = disturbances.dt_jitter > 0.0
        run = watch(Jittered(made, plant) if jittered else made, plant, s, settle=self.hold)
        pressed = self._pressed(run, by_clock=jittered)
        at = run.recording.time[1 : 1 + len(pressed)]
        first, end = at <= 1.0, at[-1]
        after = pressed[(at > s.path.duration) & (at <= s.path.duration + 1.0)].max()
        last = pressed[at > end - 1.0].max()
        felt = self._servo_reading(run.recording)
        alarm = felt[felt[:, 1] > ALARM]
        statuses = run.recording.statuses
        stopped = next((i for i, x in enumerate(statuses) if x in (Status.HOLDING, Status.FAULT, Status.BLOCKED)), None)
        record = {
            "group": "real",
            "case": case.name,
            "latched": case.latched,
            "supervision": "tolerant" if case.tolerant else "default",
            "force_first_second_N": float(pressed[first].max()),
            "force_N": float(pressed.max()),
            "force_after_lift_N": float(after),
            "force_last_second_N": float(last),
            # Wind-up would show during the hold; one newton is allowed for noise.
            "grows": bool(last > 1.01 * after + 1.0),
            "servo_reading_N": float(felt[:, 1].max()),
            "alarm_s": float(alarm[0, 0]) if len(alarm) else None,
            "finished": run.recording.finished,
            "first_stop_s": None if stopped is None else float(run.recording.time[stopped]),
            "failures": int(run.recording.metadata["failures"]),
            "seconds": float(end),
        }
        return record, np.column_stack([at, pressed])

    def _servo_reading(self, recording: Recording) -> Array:
        """Largest force at a grasp from servo deflection, every 10 ms: rows (time [s], force [N])."""
        s = self.scenario
        model = StressModel(s.cell, s.grasp, stiffness=PhysicsOptions().servos(s.cell).stiffness)
        every = max(1, round(0.01 / self.dt))
        rows = range(every, len(recording.time), every)
        size = [np.linalg.norm(model.from_servos(recording.q_command[i], recording.q[i])[:, :3], axis=1) for i in rows]
        return np.column_stack([recording.time[list(rows)], np.max(size, axis=1)])

    def _pressed(self, run: Run, *, by_clock: bool) -> Array:
        """ΔF over time. With ``by_clock`` the reference is taken at the same clock, for other steps or a slowed run."""
        reference = self.reference.recording.clock[1:]
        clock = run.recording.clock[1:]
        n = min(len(clock), len(reference))
        if not by_clock and np.allclose(clock[:n], reference[:n]):
            return force(run.added(self.reference))
        nearest = np.minimum(np.searchsorted(reference, clock - 1e-9), len(reference) - 1)
        return force(run.added(replace(self.reference, wrenches=self.reference.wrenches[nearest])))


# -- pictures ----------------------------------------------------------------------------------------------------------


def figures(curves: dict[str, dict[str, Array]], real: dict[str, Array]) -> dict[str, bytes]:
    """PNG of force over ε_p and of force over time; empty without Matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return {}
    files = {}

    def png(name: str, picture: Any) -> None:
        stream = io.BytesIO()
        picture.savefig(stream, format="png", dpi=130)
        files[name] = stream.getvalue()

    if curves:
        picture = Figure(figsize=(10, 4.2), layout="constrained")
        left, right = picture.subplots(1, 2)
        for label, curve in curves.items():
            if label.startswith(PSEUDO_INVERSE):
                left.plot(curve["eps"], curve["force"], label=label)
            line = right.semilogy(curve["time"], np.maximum(curve["force"], 1e-6), label=label)[0]
            if label.startswith(PSEUDO_INVERSE):
                right.semilogy(curve["time"], np.maximum(curve["est"], 1e-6), ":", color=line.get_color())
        left.set(
            xscale="log", yscale="log", xlabel="ε_p [mm]", ylabel="ΔF [N]", title="force against the paper's measure"
        )
        right.set(xlabel="time [s]", ylabel="ΔF [N]", title="force over time (dotted: estimate)", ylim=(1e-6, 1e4))
        for axes in (left, right):
            axes.grid(alpha=0.3)
            axes.legend(fontsize=8)
        png("force.png", picture)
    if real:
        picture = Figure(figsize=(10, 4.8), layout="constrained")
        axes = picture.subplots()
        for label, pressed in real.items():
            axes.semilogy(pressed[:, 0], np.maximum(pressed[:, 1], 1e-3), label=label, linewidth=1)
        axes.set(xlabel="time [s]", ylabel="ΔF [N]", title="closed on the measured state")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7, ncols=2)
        png("force_real.png", picture)
    return files


# -- the run -----------------------------------------------------------------------------------------------------------


#: Parts of the run. "directions" belongs to the group "real" and is not in quick runs.
PARTS = ("replays", "loop", "real", "directions")


def run(*, quick: bool, parts: Sequence[str] = PARTS) -> tuple[list[common.Record], dict[str, bytes]]:
    """Run some parts. Returns all records and the pictures."""
    records: list[common.Record] = []
    curves: dict[str, dict[str, Array]] = {}
    drawn: dict[str, Array] = {}
    lift, smooth = paper_lift(), paper_lift(time_law=TimeLaw.QUINTIC)
    numbers = (40, 400) if quick else (40, 400, 1000)
    interpolations: tuple[Interpolation, ...] = ("cubic",) if quick else ("cubic", "linear")
    tasks: list[tuple[str, Callable[[], None]]] = []

    def play(interpolation: Interpolation) -> None:
        replays = Replays(lift, interpolation)
        for steps in numbers:
            pair = []
            for kind in (PSEUDO_INVERSE, QP):
                record, curve = replays.record(kind, steps)
                pair.append(record)
                curves[f"{kind}, N = {steps}" if interpolation == "cubic" else f"{kind}, N = {steps}, linear"] = curve
            pair[1]["ratio"] = pair[1]["delta_force_N"] / pair[0]["delta_force_N"]
            records.extend(pair)

    def nominal() -> None:
        for steps in numbers:
            loop = Loop(smooth, dt=smooth.path.duration / steps, hold=0.2)
            records.extend(loop.nominal(kind) for kind in (PSEUDO_INVERSE, QP))

    def disturb(cases: list[Case], dt: float, hold: float, *, draw: bool) -> None:
        loop = Loop(smooth, dt=dt, hold=hold)
        for case in cases:
            record, curve = loop.case(case)
            records.append(record)
            if draw:
                how = {True: ", latched", False: ", not latched", None: ""}[case.latched]
                strict = "" if case.tolerant or case.latched is None else ", default supervision"
                drawn[case.name + how + strict] = curve[::5]
            progress.advance(case.name)

    geometry = list(geometry_cases("slave_1"))
    geometry += [replace(c, tolerant=False) for c in geometry if c.latched and c.base]
    real = [*geometry, *([] if quick else signal_cases())] if "real" in parts else []
    directions = list(direction_cases()) if "directions" in parts and not quick else []
    if "replays" in parts:
        tasks += [(f"replays, {i}", lambda i=i: play(i)) for i in interpolations]  # type: ignore[misc]
    if "loop" in parts:
        tasks += [("loop", nominal)]
    before = len(tasks)
    if real:
        tasks += [("real", lambda: disturb(real, 5e-3 if quick else 1e-3, HOLD, draw=True))]
    if directions:
        tasks += [("directions", lambda: disturb(directions, 5e-3, 2.0, draw=False))]
    progress = common.Progress(before + len(real) + len(directions))
    for label, task in tasks:
        progress.label = label
        progress.show()
        task()
        if label.startswith(("replays", "loop")):
            progress.advance()
    progress.close()
    return records, figures({k: v for k, v in curves.items() if "linear" not in k}, drawn)


COLUMNS = {
    "replay": (
        "N", "controller", "interpolation", "eps_p_mm", "delta_force_N", "delta_torque_Nm", "ratio", "force_per_mm",
        "correlation", "estimate_error", "estimate_error_at_rest", "servo_reading_error_N",
    ),
    "loop": ("N", "controller", "delta_force_N", "finished", "failures"),
    "real": (
        "case", "latched", "supervision", "force_first_second_N", "force_N", "force_after_lift_N",
        "force_last_second_N", "grows", "servo_reading_N", "alarm_s", "finished", "first_stop_s", "failures",
    ),
}  # fmt: skip


def tables(records: list[common.Record]) -> str:
    """One Markdown table per group."""
    parts = []
    for group, columns in COLUMNS.items():
        rows = [r for r in records if r["group"] == group]
        if rows:
            parts.append(f"## {group}\n\n{common.markdown_table(rows, columns)}")
    return "\n\n".join(parts) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Run, print the tables, write the files."""
    parser: argparse.ArgumentParser = common.arguments(__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="which parts (all)")
    options = parser.parse_args(arguments)
    plant = PhysicsPlant.of(paper_lift())
    description = common.describe(
        "physics",
        {
            "servo stiffness [N·m/rad]": plant.stiffness[:6].tolist(),
            "servo damping": plant.options.servos(plant.cell).damping[:6].tolist(),
            "engine step [s]": ENGINE_STEP,
            "object": f"{plant.object_mass:g} kg",
            "loop step [s]": "0.005" if options.quick else "0.001 (directions: 0.005)",
        },
    )
    description["versions"] |= common.versions(["mujoco"])
    print(common.header(description), file=sys.stderr)
    began = time.perf_counter()
    records, pictures = run(quick=options.quick, parts=options.parts)
    text = tables(records)
    print(text)
    print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr)
    common.save(
        records, description, json_file=options.json, out=options.out, files={"physics.md": text.encode(), **pictures}
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
