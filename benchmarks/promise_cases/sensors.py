"""Wrist sensors that are wrong, and what is found of them: the paper's lift in an engine, base of one arm 1 mm off."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.forces import WristSensor
from coopqp.planning import Payload
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array
from promise_cases import Promise

#: Noise of forces [N]; of torques a tenth of it [N·m].
NOISE = 1.0
ARMS = ("master", "slave_1", "slave_2")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fault:
    """What is wrong with the sensors: how they read, and what happens to the samples.

    Attributes:
        sensors: how they read, by arm.
        bias: size of a random constant force of each sensor [N].
        drift: how fast a random force of each sensor grows [N/s].
        lost: share of lost samples.
        freeze: time from which on all repeat their last reading [s].
        broken: share of samples in which one number of one sensor is ``broken_by``.
        broken_by: NaN or infinite.
    """

    sensors: Mapping[str, WristSensor] = dataclasses.field(default_factory=dict)
    bias: float = 0.0
    drift: float = 0.0
    lost: float = 0.0
    freeze: float = np.inf
    broken: float = 0.0
    broken_by: float = np.nan


def turned(degrees: float, axis: int = 1) -> Array:
    """The rotation about an axis of the tool."""
    return np.asarray(pin.exp3(np.deg2rad(degrees) * np.eye(3)[axis]))


def one(arm: str = "slave_2", **sensor: Any) -> Fault:
    """One sensor that reads otherwise."""
    return Fault(sensors={arm: WristSensor(**{"delay": 0.01} | sensor)})


def every(**sensor: Any) -> Fault:
    """All sensors read otherwise, in the same way."""
    return Fault(sensors={arm: WristSensor(**{"delay": 0.01} | sensor) for arm in ARMS})


def swapped(one: str, other: str) -> Fault:
    """Two sensors read the wrenches of each other's arms."""
    return Fault(sensors={one: WristSensor(reads=other, delay=0.01), other: WristSensor(reads=one, delay=0.01)})


#: Faults that are named, and errors that are tolerated.
NAMED: dict[str, Fault] = {
    "flipped": one("master", force_gain=-1.0, torque_gain=-1.0),
    "torques flipped": one(torque_gain=-1.0),
    "torques dead": one("slave_1", torque_gain=0.0),
    "dead": one(force_gain=0.0, torque_gain=0.0),
    "torques in N·mm": one("master", torque_gain=1000.0),
    "all flipped": every(force_gain=-1.0, torque_gain=-1.0),
    "all torques flipped": every(torque_gain=-1.0),
    "slaves swapped": swapped("slave_1", "slave_2"),
    "master and slave_1 swapped": swapped("master", "slave_1"),
    "turned by 30°": one(rotation=turned(30.0)),
    "turned by 90°": one("master", rotation=turned(90.0)),
    "turned by 180°": one("slave_1", rotation=turned(180.0)),
    "turned by 30° about another axis": one("master", rotation=turned(30.0, axis=2)),
    "all turned by 90°": every(rotation=turned(90.0)),
    "all turned by 180°": every(rotation=turned(180.0)),
    "frozen at rest": Fault(freeze=0.3),
    "frozen in motion": Fault(freeze=6.0),
    "gain 0.5": one(force_gain=0.5, torque_gain=0.5),
    "gain 1.5": one("slave_1", force_gain=1.5, torque_gain=1.5),
    "gain 2": one("master", force_gain=2.0, torque_gain=2.0),
    "bias 15 N": Fault(bias=15.0),
    "bias 30 N": Fault(bias=30.0),
    "drift 3 N/s": Fault(drift=3.0),
    "drift 10 N/s": Fault(drift=10.0),
    "60 % lost": Fault(lost=0.6),
    "90 % lost": Fault(lost=0.9),
    "delay 30 ms": every(delay=0.03),
    "delay 50 ms": every(delay=0.05),
    "delay 120 ms": every(delay=0.12),
}
TOLERATED: dict[str, Fault] = {
    "right": Fault(),
    "turned by 10°": one(rotation=turned(10.0, axis=0)),
    "gain 0.8": one(force_gain=0.8, torque_gain=0.8),
    "gain 1.2": one(force_gain=1.2, torque_gain=1.2),
    "bias 9 N": Fault(bias=9.0),
    "drift 1 N/s": Fault(drift=1.0),
    "30 % lost": Fault(lost=0.3),
    "delay 20 ms": every(delay=0.02),
    "20 % with a NaN": Fault(broken=0.2),
    "5 % with an infinite number": Fault(broken=0.05, broken_by=np.inf),
}


class Readings:
    """The readings of a fault, from real wrenches."""

    def __init__(self, fault: Fault, seed: int) -> None:
        self.fault, self.rng = fault, np.random.default_rng(seed)
        ways = self.rng.normal(size=(2, len(ARMS), 3))
        self.ways = ways / np.linalg.norm(ways, axis=2, keepdims=True)
        self.past: list[tuple[float, Array]] = []
        self.last: Array | None = None
        self.own = [fault.sensors.get(arm, WristSensor(delay=0.01)) for arm in ARMS]

    def read(self, time: float, wrenches: Array) -> Array:
        """What arrives at a time [s], (N, 6) [N, N·m]."""
        if time >= self.fault.freeze and self.last is not None:
            return self.last.copy()
        self.past.append((time, wrenches.copy()))
        out = np.zeros((len(ARMS), 6))
        for k, sensor in enumerate(self.own):
            arm = k if sensor.reads is None else ARMS.index(sensor.reads)
            heard = [w for at, w in self.past if at <= time - sensor.delay + 1e-9] or [self.past[0][1]]
            w = heard[-1][arm]
            out[k, :3] = sensor.force_gain * sensor.rotation @ w[:3]
            out[k, 3:] = sensor.torque_gain * sensor.rotation @ w[3:]
        self.past = self.past[-60:]
        out[:, :3] += self.fault.bias * self.ways[0] + self.fault.drift * time * self.ways[1]
        out += NOISE * np.array([1.0] * 3 + [0.1] * 3) * self.rng.normal(size=out.shape)
        out[self.rng.random(len(ARMS)) < self.fault.lost] = np.nan
        if self.rng.random() < self.fault.broken:
            out[self.rng.integers(len(ARMS)), self.rng.integers(6)] = self.fault.broken_by
        self.last = out
        return out


def beside_the_load(wrenches: Array, points: Array, rotations: Array) -> Array:
    """Forces of the arms beside their least shares of the load (N, 3) [N], a torque counting as 10 times its N·m."""
    n = len(points)
    A = np.zeros((6, 6 * n))
    f = np.zeros(6 * n)
    for k, (p, R) in enumerate(zip(points, rotations, strict=True)):
        A[:3, 6 * k : 6 * k + 3] = A[3:, 6 * k + 3 : 6 * k + 6] = np.eye(3)
        A[3:, 6 * k : 6 * k + 3] = [[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]]
        f[6 * k : 6 * k + 3], f[6 * k + 3 : 6 * k + 6] = R @ wrenches[k, :3], R @ wrenches[k, 3:]
    scale = np.tile([1.0] * 3 + [0.1] * 3, n)
    share = scale * (np.linalg.pinv(A * scale) @ (A @ f))
    out: Array = (f - share).reshape(n, 6)[:, :3]
    return out


def run(fault: Fault, seed: int, *, longest: float = 10.0) -> tuple[bool, float, float, bool]:
    """Whether a sensor was named, the largest force that was added, that in motion [N], and whether it finished."""
    lift = paper_lift(time_law="quintic")
    off = pin.SE3(pin.exp3(np.deg2rad(0.1) / np.sqrt(3.0) * np.ones(3)), 1e-3 / np.sqrt(3.0) * np.ones(3))
    plant = coopqp.simulation.PhysicsPlant.of(
        lift,
        options={"grips": "where they are"},
        disturbances=coopqp.simulation.Disturbances(base_offset={"slave_2": off}),
    )
    payload = Payload(mass=lift.object_mass, centre=lift.T_object_body.translation)
    controller = coopqp.ForceController(
        coopqp.QPController(lift.cell, lift.grasp, lift.path, dt=0.005),
        coopqp.ForceOptions(stiffness=plant.stiffness, payload=payload),
    )
    q = plant.reset(lift.q_start)
    controller.reset(q)
    points = np.array([X.translation for X in lift.grasp.T_object_tool])
    turns = np.array([X.rotation for X in lift.grasp.T_object_tool])
    readings, time, most, moving = Readings(fault, seed), 0.0, 0.0, 0.0
    held: str | None = None
    named = False
    while time < longest:
        step = controller.step(q, wrenches=readings.read(time, plant.sensed_wrenches()))
        q = plant.apply(step)
        time += 0.005
        force = float(np.linalg.norm(beside_the_load(plant.sensed_wrenches(), points, turns), axis=1).max())
        most = max(most, force)
        named = named or "relax more slowly" in step.reason
        moving = max(moving, force) if step.rate > 0.0 else moving
        if step.status in (coopqp.Status.HOLDING, coopqp.Status.FAULT):
            held = held or step.reason
            longest = min(longest, time + 0.2)
        if step.finished:
            longest = min(longest, time + 0.3)
    named = named or (held is not None and ("sensor" in held or "wrench of arm" in held))
    return named, most, moving, held is None and step.finished


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    seeds = range(1) if quick else range(10)
    kinds = ("slaves swapped",) if quick else tuple(NAMED)
    rows = [run(NAMED[kind], seed) for kind in kinds for seed in seeds]
    yield Promise("wrong sensors that are not named, share of runs", float(np.mean([not r[0] for r in rows])), 0.05, "")
    yield Promise("wrong sensors: largest force added", max(r[1] for r in rows), 50.0, "N")
    if quick:
        return
    rows = [run(fault, seed) for fault in TOLERATED.values() for seed in seeds]
    yield Promise(
        "small errors of sensors: runs that are held or not finished, share",
        float(np.mean([not r[3] for r in rows])),
        0.0,
        "",
    )
    yield Promise("small errors of sensors: largest force, presses included", max(r[1] for r in rows), 20.0, "N")
    yield Promise("small errors of sensors: largest force in motion", max(r[2] for r in rows), 20.0, "N")
