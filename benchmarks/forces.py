"""Load sharing and calibration on the paper's lift: newtons, shares of torque limits, and seconds.

Records have the keys of ``KEYS``; what does not apply is null. Forces are the largest norm at a grasp less the load in
a lift with everything where the model has it [N]. ``peak_N`` and ``rest_N`` are those of a lift with the controller of
the record, ``without_N`` that at rest without it. Cases:

``relaxed``        force sensors at the tools, and the arms relax what they feel. Forces are those beside an ideal
                   share of the load; peaks count from the first step where the arms grip where they are, else from
                   the first motion;
``palms``          a box between open palms: normal forces in motion and at the end, and how far a palm slipped, also
                   in 50 runs with disturbed bases, masses and sensors;
``step_cost``      time of a step with wrenches and of one without [s];
``base_off_lift``  one base is off by 1 mm and 0.1°; the controller's model is calibrated from one lift before;
``feed_forward``   forces in the engine less those that are shared, with the torques fed forward, and without;
``torque_drives``  the paper's lift by position servos and by torque-controlled drives, with wrong masses of arms and
                   payload, and a base off; ``error_mm``: how far the object was off its path at most;
``heavy_lift``     torques of a slow lift, the load shared or in equal parts;
``fastest_lift``   the shortest lift by torque limits.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from common import Record

from coopqp import (
    ControlStep,
    ForceController,
    ForceOptions,
    Grasp,
    HoldPath,
    QPController,
    QPOptions,
    Recording,
    RobotCell,
    SupervisionOptions,
    inverse_kinematics,
    simulate,
)
from coopqp.baselines import PseudoInverseController
from coopqp.errors import StartWarning
from coopqp.forces import CalibrationOptions, LoadBound, LoadShare, internal_wrenches, load_use
from coopqp.model import CellState
from coopqp.planning import Payload, time_path
from coopqp.scenarios import Scenario, palm_box, paper_lift
from coopqp.simulation import (
    Disturbances,
    PhysicsPlant,
    Replay,
    calibrate_runs,
    engine_plant,
    exact_motion,
    misplaced,
    read_loads,
    run_in_engine,
)
from coopqp.spatial import Array

KEYS = (
    "case", "variant", "controller", "peak_N", "rest_N", "without_N", "slip_mm", "torque_use", "time_s", "finished",
    "status", "error_mm",
)  # fmt: skip
DIAGONAL = np.ones(3) / np.sqrt(3.0)
BASE_OFF = pin.SE3(pin.exp3(np.deg2rad(0.1) * DIAGONAL), 1e-3 * DIAGONAL)
#: The first run squeezes on purpose: no supervision may stop it.
TOLERANT = QPOptions(supervision=SupervisionOptions(slow_from=0.005, hold_from=0.01, stall_samples=10_000))
INTERNAL = 50.0  # N
SETTLE = 0.5  # s after the end of the path, over which the force at rest is a mean
MASSES = (20.0, 40.0, 48.0, 53.0)
#: Lifts with sensors in a quick run: one for each that is off.
RELAXED_QUICK = (
    "base of slave_2", "base of slave_2, gripped where it is", "base of slave_2, servos ×10", "grip of slave_2, 2 mm",
    "sensor of slave_2 flipped", "sensor of slave_2 dead", "base of slave_2, 30 % lost", "payload taken for 1.5 of it",
)  # fmt: skip
#: Settings of the plant's drives by name, and the masses in their model as multiples of the real ones.
DRIVES: dict[str, dict[str, Any]] = {
    "position servos": {"servo": "position"},
    "computed torque": {"servo": "computed torque"},
    "observer": {"servo": "disturbance observer"},
    "observer, wrist sensors": {"servo": "disturbance observer", "wrist_sensors": True},
}
ASSUMED: dict[str, dict[str, Any]] = {"exact": {}} | {
    f"{what} × {factor:g}": dict.fromkeys(keys, factor)
    for what, keys in (
        ("arms", ("assumed_mass",)),
        ("payload", ("assumed_payload",)),
        ("both", ("assumed_mass", "assumed_payload")),
    )
    for factor in (0.5, 1.5)
}


def record(case: str, variant: str, controller: str, **values: Any) -> Record:
    """A record with all keys."""
    return {key: {"case": case, "variant": variant, "controller": controller, **values}.get(key) for key in KEYS}


def box(task: Scenario, mass: float) -> Payload:
    """The object as a homogeneous box."""
    x, y, z = task.object_size
    inertia = mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    return Payload(mass=mass, centre=task.T_object_body.translation, inertia=inertia)


def lifted(task: Scenario, plant: PhysicsPlant, cell: RobotCell, grasp: Grasp) -> tuple[Recording, Array]:
    """A lift with a model on a plant; wrenches at each step (T, N, 6)."""
    q, wrenches = inverse_kinematics(cell, grasp, task.path.pose(0.0), task.q_start), list[Array]()
    controller = QPController(cell, grasp, task.path, dt=task.dt, options=TOLERANT)
    run = simulate(controller, plant, q_start=q, settle=0.5, observe=lambda _: wrenches.append(plant.wrenches()))
    return run, np.array(wrenches)


def forces(wrenches: Array, load: Array) -> Array:
    """Largest force at a grasp less the load, at each step (T,) [N]."""
    n = min(len(wrenches), len(load))
    found: Array = np.linalg.norm((wrenches[:n] - load[:n])[:, :, :3], axis=2).max(axis=1)
    return found


def base_off_lift(quick: bool) -> Iterator[Record]:
    """Every arm in turn."""
    task = paper_lift(time_law="quintic")
    load = lifted(task, PhysicsPlant.of(task), task.cell, task.grasp)[1]
    for arm in ("slave_2",) if quick else task.cell.arm_names:
        for noise in (0.0, 1e-4):

            def plant(seed: int, arm: str = arm, noise: float = noise) -> PhysicsPlant:
                off = Disturbances(base_offset={arm: BASE_OFF}, encoder_noise=noise, seed=seed)
                return PhysicsPlant.of(task, disturbances=off)

            run, before = lifted(task, plant(0), task.cell, task.grasp)
            found = calibrate_runs([run], cell=task.cell, options=CalibrationOptions(encoder_noise=max(noise, 1e-5)))
            again, after = lifted(task, plant(1), found.cell, found.grasp)
            force, without = forces(after, load), forces(before, load)
            yield record(
                "base_off_lift", f"{arm}, encoders ±{noise:g} rad", "calibrated", peak_N=float(force.max()),
                rest_N=float(force[-1]), without_N=float(without[-1]), time_s=float(again.time[-1]),
                finished=again.finished, status=again.statuses[-1].value,
            )  # fmt: skip


def feed_forward(quick: bool) -> Iterator[Record]:
    """A lift in 1.2 s with exact inverse kinematics."""
    task = paper_lift(time_law="quintic", duration=1.2)
    load = LoadShare(task.cell, task.grasp, box(task, 20.0), internal_force=INTERNAL)
    motion, off = exact_motion(task.cell, task.grasp, task.path, task.q_start), list[Array]()
    for shared in (None, load):
        plant, wrenches = PhysicsPlant.of(task, load=shared), list[Array]()

        def read(_: ControlStep, plant: PhysicsPlant = plant, wrenches: list[Array] = wrenches) -> None:
            wrenches.append(plant.wrenches())

        controller = Replay(task.cell, task.grasp, task.path, motion, dt=0.006 if quick else 0.002)
        run = simulate(controller, plant, q_start=task.q_start, observe=read)
        off.append(forces(np.array(wrenches), load_use(load, run.time, run.q_command).wrenches[1:]))
    yield record(
        "feed_forward", "20 kg in 1.2 s", "shared load", peak_N=float(off[1].max()), rest_N=float(off[1][-1]),
        without_N=float(off[0].max()), time_s=float(run.time[-1]), finished=run.finished, status=run.statuses[-1].value,
    )  # fmt: skip


def torque_drives(quick: bool) -> Iterator[Record]:
    """Exact inverse kinematics, so that only the drives err; wrist sensors are 5 ms late."""
    task = paper_lift(time_law="quintic", duration=1.5 if quick else 3.0)
    load = LoadShare(task.cell, task.grasp, box(task, 20.0), internal_force=INTERNAL)
    motion, most = exact_motion(task.cell, task.grasp, task.path, task.q_start), load.torque_limits
    wrong = {"both × 0.5": ASSUMED["both × 0.5"]} if quick else {**ASSUMED, "base of slave_2": {}}
    for variant, assumed in wrong.items():
        for drives, settings in DRIVES.items():
            off = {"slave_2": BASE_OFF} if variant.startswith("base") else {}
            plant = PhysicsPlant.of(
                task, load=load, options={**settings, **assumed, "hand_over": 0.0},
                disturbances=Disturbances(base_offset=off, wrench_latency=0.005),
            )  # fmt: skip
            felt, use, away = list[float](), list[float](), list[float]()

            def read(
                step: ControlStep, plant: PhysicsPlant = plant, felt: list[float] = felt, use: list[float] = use,
                away: list[float] = away,
            ) -> None:  # fmt: skip
                internal = internal_wrenches(plant.sensed_wrenches(), task.grasp)
                felt.append(float(np.linalg.norm(internal[:, :3], axis=1).max()))
                use.append(float((np.abs(plant.joint_torques) / most).max()))
                pose = task.path.pose(step.clock_next)
                away.append(1e3 * float(np.linalg.norm(plant.T_world_object.translation - pose.translation)))

            controller = Replay(task.cell, task.grasp, task.path, motion, dt=0.006)
            run = simulate(controller, plant, q_start=task.q_start, settle=0.5, observe=read)
            yield record(
                "torque_drives", variant, drives, peak_N=max(felt), rest_N=felt[-1], torque_use=max(use),
                time_s=float(run.time[-1]), finished=run.finished, status=run.statuses[-1].value, error_mm=max(away),
            )  # fmt: skip


def heavy_lift(quick: bool) -> Iterator[Record]:
    """Torques of 53 kg in 6 s, from rest to rest; equal parts: a third of the force at each grip, moments likewise."""
    task = paper_lift(time_law="quintic", duration=6.0)
    motion, time = exact_motion(task.cell, task.grasp, task.path, task.q_start), np.linspace(0, 6, 31 if quick else 121)
    q = np.array([motion(t) for t in time])
    load = LoadShare(task.cell, task.grasp, box(task, 53.0), internal_force=INTERNAL)
    use = load_use(load, time, q)
    yield record(
        "heavy_lift", "53 kg", "shared load", torque_use=float(use.joint.max()), finished=use.feasible, time_s=6.0,
        rest_N=float(INTERNAL * use.internal[-1].max()), peak_N=float(INTERNAL * use.internal.max()),
    )  # fmt: skip
    most, n = 0.0, len(task.cell)
    for x, pose in zip(q, map(task.path.pose, time), strict=True):
        f, state = load.wrench(pose.rotation), CellState(task.cell, x)
        arms = pin.computeGeneralizedGravity(task.cell.model, task.cell.model.createData(), x)
        levers = [np.cross(X.translation, f[:3] / n) for X in task.grasp.T_object_tool]
        for k, (s, X) in enumerate(zip(task.cell.v_slices, task.grasp.T_object_tool, strict=True)):
            w = np.concatenate([f[:3] / n, levers[k] + (f[3:] - np.sum(levers, axis=0)) / n])
            torque = arms[s] + state.jacobian(k).T @ X.action.T @ w
            most = max(most, float((np.abs(torque) / load.torque_limits[s]).max()))
    yield record("heavy_lift", "53 kg", "equal parts", torque_use=most, finished=most <= 1.0, time_s=6.0)


def fastest_lift(quick: bool) -> Iterator[Record]:
    """By torque limits alone: the joints' speeds and accelerations are out of the way."""
    task = paper_lift()
    cell = task.cell.with_limits(velocity=1e3, acceleration=1e4)
    for mass in MASSES[1:2] if quick else MASSES:
        load = LoadShare(cell, task.grasp, box(task, mass), internal_force=INTERNAL)
        path = time_path(
            cell, task.grasp, task.path, q_start=task.q_start, bounds=[LoadBound(load)], share=1.0, knots=100
        )
        clocks, q = np.linspace(0.0, path.duration, 60), [task.q_start]
        for clock in clocks[1:]:
            q.append(inverse_kinematics(cell, task.grasp, path.pose(clock), q[-1], limits=False))
        use = load_use(load, clocks, np.array(q))
        inside = slice(2, -2)  # the acceleration jumps at both ends, where differences reach over them
        yield record(
            "fastest_lift", f"{mass:g} kg", "load bound", torque_use=float(use.joint[inside].max()),
            peak_N=float(INTERNAL * use.internal[inside].max()), time_s=path.duration,
            finished=bool(use.share[inside].min() > 0.995),
        )  # fmt: skip


def relaxed(quick: bool) -> Iterator[Record]:
    """A lift with force sensors; peaks are those from the first step on, the start included."""
    task = paper_lift(time_law="quintic")
    stiff = PhysicsPlant.of(task).stiffness
    late = {"wrench_latency": 0.01}
    cases: dict[str, dict[str, Any]] = {}
    for arm in ("slave_2",) if quick else task.cell.arm_names:
        base = {"base_offset": {arm: BASE_OFF}, **late}
        cases[f"base of {arm}"] = {"off": base}
        cases[f"base of {arm}, gripped where it is"] = {"off": base, "options": {"grips": "where they are"}}
        grip = misplaced(task.cell, task.grasp, {arm: pin.SE3(np.eye(3), 2e-3 * DIAGONAL)})
        cases[f"grip of {arm}, 2 mm"] = {"off": late, "grasp": grip}
        for factor in (0.1, 10.0):
            options = {"grips": "where they are", "stiffness": factor * stiff}
            cases[f"base of {arm}, servos ×{factor:g}"] = {"off": base, "options": options}
        for what, gain in (("flipped", -1.0), ("dead", 0.0), ("gain 2", 2.0)):
            cases[f"sensor of {arm} {what}"] = {"off": {"wrench_gain": {arm: gain}, **late}}
    noisy = {"wrench_noise": 1.0, "wrench_bias": 2.0, "encoder_noise": 1e-4}
    cases["base of slave_2, noise"] = {"off": {"base_offset": {"slave_2": BASE_OFF}, **noisy, **late}}
    lost = {"base_offset": {"slave_2": BASE_OFF}, "wrench_drop_share": 0.3, **late}
    cases["base of slave_2, 30 % lost"] = {"off": lost}
    slaves = np.vstack([np.zeros((1, 6)), np.ones((2, 6))])
    cases["base of slave_2, the master minds none"] = {
        "off": {"base_offset": {"slave_2": BASE_OFF}, **late},
        "mind": slaves,
    }
    growth = 2.2e-3 / task.object_size[1]
    cases["plate grows by 2.2 mm in 3 s"] = {"off": {"object_growth": growth, "growth_period": 12.0, **late}}
    for share in (0.5, 1.5):
        cases[f"payload taken for {share:g} of it"] = {"off": late, "payload": share}
    cases["drift of the pseudo-inverse, N = 400"] = {"off": late, "baseline": True}
    if not quick:
        slow = {"object_growth": growth, "growth_period": 120.0, "wrench_noise": 1.0, "wrench_bias": 2.0}
        cases["ten minutes"] = {"off": {**slow, **late}, "hold": 600.0}
    for name, case in cases.items():
        off = Disturbances(**case["off"])
        load = None
        if "payload" in case:
            load = LoadShare(task.cell, task.grasp, box(task, 20.0 * case["payload"]), internal_force=INTERNAL)
        plant = PhysicsPlant.of(
            task, disturbances=off, options=case.get("options"), real_grasp=case.get("grasp"), load=load
        )
        path = HoldPath(task.path.pose(0.0), duration=case["hold"]) if "hold" in case else task.path
        inner: QPController | PseudoInverseController = QPController(task.cell, task.grasp, path, dt=task.dt)
        if "baseline" in case:
            inner = PseudoInverseController(task.cell, task.grasp, path, dt=task.dt)
        payload = box(task, 20.0 * case.get("payload", 1.0))
        controller = ForceController(inner, ForceOptions(stiffness=stiff, payload=payload, directions=case.get("mind")))
        felt, from_start = list[Array](), "gripped" in name or "hold" in case

        def feel(_: ControlStep, plant: PhysicsPlant = plant, felt: list[Array] = felt) -> None:
            felt.append(internal_wrenches(plant.sensed_wrenches(), task.grasp)[:, :3])

        run = simulate(controller, plant, q_start=task.q_start, settle=SETTLE, observe=feel)
        first = 0 if from_start else int(np.argmax(run.rate > 0.0))
        internal = np.array(felt)
        at_rest = internal[-round(SETTLE / task.dt) :].mean(axis=0)
        yield record(
            "relaxed", name, "ForceController", time_s=float(run.time[-1]),
            peak_N=float(np.linalg.norm(internal[first:], axis=2).max()),
            rest_N=float(np.linalg.norm(at_rest, axis=1).max()), finished=run.finished, status=run.statuses[-1].value,
        )  # fmt: skip


def palms(quick: bool) -> Iterator[Record]:
    """A box between open palms, held by friction; forces are the normal ones while it moves."""
    for squeeze in (200.0,) if quick else (180.0, 200.0, 250.0):
        for base_off in (False, True):
            task = palm_box(squeeze=squeeze, base_off=base_off)
            yield carried(f"{squeeze:g} N{', base off' if base_off else ''}", task, task)
    for run in range(1 if quick else 50):
        yield carried(f"disturbed, run {run}", palm_box(), disturbed_box(run))


def disturbed_box(seed: int) -> Scenario:
    """What is really there: both bases off by 1 mm and 0.1°, a mass off by up to 15 %, noisy sensors."""
    task, rng = palm_box(), np.random.default_rng(seed)
    assert task.engine is not None
    offsets = {}
    for name in task.cell.arm_names:
        turn, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        offsets[name] = pin.SE3(pin.exp3(np.deg2rad(0.1) * turn), 1e-3 * way)
    disturbances = {**task.engine.disturbances, "base_offset": offsets, "wrench_noise": 0.5, "seed": seed}
    engine = replace(task.engine, disturbances=disturbances)
    return replace(task, object_mass=task.object_mass * rng.uniform(0.85, 1.15), engine=engine)


def carried(variant: str, said: Scenario, real: Scenario) -> Record:
    """The record of a lift; a box that is lost has an infinite slip."""
    plant = engine_plant(real)
    run = run_in_engine(said, plant=plant)
    loads = read_loads(said.cell, run)
    assert loads is not None
    return record(
        "palms", variant, "ForceController",
        peak_N=float(loads.internal[loads.moves :].max(initial=0.0)), rest_N=float(loads.internal[-1].max()),
        slip_mm=1e3 * plant.slip() if plant.gripped else np.inf, torque_use=float(loads.torque_use.max()),
        time_s=float(run.time[-1]), finished=run.finished, status=run.statuses[-1].value,
    )  # fmt: skip


def step_cost(quick: bool) -> Iterator[Record]:
    """Interleaved medians of a step on measured configurations, with wrenches and without, while the object moves.

    Paced: after a pause of a millisecond, with caches as cold as in a control program.
    """
    task, rng = paper_lift(time_law="quintic"), np.random.default_rng(0)
    steps, size = 300 if quick else 1500, (len(task.cell), 6)
    for variant, pause in (("hot", 0.0), ("paced", 1e-3)):
        plain = QPController(task.cell, task.grasp, task.path, dt=1e-3)
        inner = QPController(task.cell, task.grasp, task.path, dt=1e-3)
        minding = ForceController(inner, ForceOptions(stiffness=1e5, presses=False))  # wrenches of noise alone
        for controller in (plain, minding):
            controller.reset(task.q_start)
        q, rate = [task.q_start, task.q_start], 0.0
        while rate < 0.99:  # until the object moves
            step = minding.step(q[1], wrenches=0.3 * rng.normal(size=size))
            q[1], rate = step.q_next, step.rate
        times: dict[str, list[float]] = {"QPController": [], "ForceController": []}
        for _ in range(steps):
            noise, wrenches = rng.uniform(-1e-4, 1e-4, task.cell.nq), 2.0 * rng.normal(size=size)
            measured = [x + noise for x in q]
            if pause:
                time.sleep(pause)
            began = time.perf_counter()
            step = plain.step(measured[0])
            times["QPController"].append(time.perf_counter() - began)
            if pause:
                time.sleep(pause)
            began = time.perf_counter()
            minded = minding.step(measured[1], wrenches=wrenches)
            times["ForceController"].append(time.perf_counter() - began)
            q = [step.q_next, minded.q_next]
        for name, spent in times.items():
            yield record("step_cost", variant, name, time_s=float(np.median(spent)))


CASES = (relaxed, palms, step_cost, base_off_lift, feed_forward, torque_drives, heavy_lift, fastest_lift)


def main(argv: Sequence[str] | None = None) -> int:
    """Run, print the table, write the files."""
    options = common.arguments(__doc__.partition("\n")[0] if __doc__ else "").parse_args(argv)
    description = common.describe(
        "forces", {"internal force": f"{INTERNAL:g} N", "torque limits": "of the model (assumed)"}
    )
    description["versions"] |= common.versions(["mujoco", "toppra"])
    print(common.header(description), file=sys.stderr)
    progress, records = common.Progress(len(CASES)), list[Record]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StartWarning)  # arms start where the closed grips put them
        for case in CASES:
            progress.label = case.__name__
            progress.show()
            records += case(options.quick)
            progress.advance()
    progress.close()
    table = common.markdown_table(records, KEYS)
    print(f"## Forces\n\n{table}\n")
    common.save(records, description, json_file=options.json, out=options.out, files={"forces.md": table.encode()})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
