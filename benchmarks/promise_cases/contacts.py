"""An object that meets something on its way: a springy table or wall in an engine, with default options."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from coopqp import ForceController, ForceOptions, QPController, Status, WaypointPath
from coopqp.planning import Payload
from coopqp.scenarios import paper_lift
from coopqp.simulation import Disturbances, PhysicsPlant
from coopqp.spatial import Array
from promise_cases import Promise
from promise_cases.forces import DAMPING, STIFFNESS

#: How much too early the object meets it, of twice that way, and when its path has its largest speed [m].
EARLY = 0.04
#: Time after the first touch from which on a force stands [s].
STANDS = 0.3
#: Directions of motion in the world.
WAYS = {"down": (0.0, 0.0, -1.0), "x": (1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0)}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """What the object meets, and how.

    Attributes:
        speed: of the object when it touches [m/s].
        late: age of the wrenches [s].
        dt: length of a step [s].
        way: name of the direction of motion.
        mass: of the object [kg].
        spring: stiffness of what it meets [N/m].
        acceleration: limit of the joints [rad/s²].
        early: how much too early it meets it [m].
        edge: with one edge only.
    """

    speed: float
    late: float
    dt: float
    way: str = "down"
    mass: float = 20.0
    spring: float = 1e6
    acceleration: float = np.inf
    early: float = EARLY
    edge: bool = False


class Spring:
    """A wall of springs, one at each corner of the object, for the engine: it pushes against a direction."""

    def __init__(self, plant: PhysicsPlant, size: Array, body: pin.SE3, way: Array, case: Case) -> None:
        signs = np.array(np.meshgrid([0.5] if case.edge else [-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
        self.corners, self.way, self.case = np.array([body.act(c) for c in signs * size]), way, case
        self.id = plant.mj_model.body("object").id
        O = plant.T_world_object
        self.at = max(float(way @ O.act(c)) for c in self.corners) + case.early
        self.stiff, self.damp = case.spring / 4.0, 0.2 * np.sqrt(case.spring * case.mass) / 4.0
        self.jacobian, self.inertia = np.zeros((3, plant.mj_model.nv)), np.zeros(plant.mj_model.nv)
        self.most, self.energy, self.touched, self.seen = 0.0, 0.0, np.inf, list[tuple[float, float]]()

    def __call__(self, model: Any, data: Any) -> None:
        """Add its force to the engine's."""
        R, p = data.xmat[self.id].reshape(3, 3), data.xpos[self.id]
        force = 0.0
        for corner in self.corners:
            point = p + R @ corner
            deep = float(self.way @ point) - self.at
            if deep <= 0.0:
                continue
            mujoco.mj_jac(model, data, self.jacobian, None, point, self.id)
            push = max(self.stiff * deep + self.damp * float(self.way @ self.jacobian @ data.qvel), 0.0)
            data.qfrc_passive[:] -= push * (self.way @ self.jacobian)
            force += push
        self.most = max(self.most, force)
        if not force and np.isinf(self.touched):  # twice the energy of what moves
            mujoco.mj_mulM(model, data, self.inertia, data.qvel)
            self.energy = float(self.inertia @ data.qvel)

    def look(self, time: float) -> None:
        """Note the largest force since the last look."""
        self.seen.append((time, self.most))
        self.touched = min(self.touched, time) if self.most else self.touched
        self.most = 0.0


@dataclasses.dataclass
class Met:
    """What a run showed.

    Attributes:
        peak, stands: the largest force of what it met, and that from 0.3 s after the first touch on [N].
        bound: a bound of the peak [N], see :func:`meet`.
        late: time from the first touch until it is named [ms].
        unnamed: steps from then on that are not HOLDING, or do not name it.
    """

    peak: float
    stands: float
    bound: float
    late: float
    unnamed: int


def impedance(task: Any, way: Array) -> tuple[float, float]:
    """Stiffness [N/m] and damping [N·s/m] with which the servos of all arms hold the load's centre in a direction."""
    model, data = task.cell.model, task.cell.model.createData()
    pin.computeJointJacobians(model, data, task.q_start)
    pin.updateFramePlacements(model, data)
    centre = (task.path.pose(0.0) * task.T_object_body).translation
    out = []
    for servo in (STIFFNESS, DAMPING):
        sum_ = np.zeros((6, 6))
        for frame, v in zip(task.cell.tool_frames, task.cell.v_slices, strict=True):
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:, v]
            J[:3] -= np.cross(centre - data.oMf[frame].translation, J[3:], axis=0)
            inverse = np.linalg.inv(J)
            sum_ += inverse.T @ np.diag(servo) @ inverse
        out.append(float(way @ sum_[:3, :3] @ way))
    return out[0], out[1]


def meet(case: Case) -> Met:
    """Move the object against something that it meets too early.

    Until the first wrench that shows it is answered, and the joints have braked, the object goes on for a time t: into
    a soft thing by v t, so that the peak is at most k v t. A hard one stops the moving masses at once, with v √(k m)
    at most, and the servos press on, with v (D + K t). What pushes less than the limit counts as no contact.
    """
    task = dataclasses.replace(paper_lift(), object_mass=case.mass)
    cell, way = task.cell.with_limits(acceleration=case.acceleration), np.array(WAYS[case.way])
    plant = PhysicsPlant.of(
        task, options={"grips": "where they are"}, disturbances=Disturbances(wrench_latency=case.late)
    )
    start = task.path.pose(0.0)
    end = pin.SE3(start.rotation, start.translation + 2.0 * case.early * way)
    seconds = 1.875 * 2.0 * case.early / case.speed  # of a quintic
    path = WaypointPath([start, end], durations=[seconds])
    payload = Payload(mass=case.mass, centre=task.T_object_body.translation)
    inner = QPController(cell, task.grasp, path, dt=case.dt)
    made = ForceController(inner, ForceOptions(stiffness=np.tile(STIFFNESS, 3), payload=payload))
    q = plant.reset(task.q_start)
    made.reset(q)
    wall = Spring(plant, np.array(task.object_size), task.T_object_body, way, case)
    now, named, unnamed, ends, braking = 0.0, np.inf, 0, np.inf, 0.0
    mujoco.set_mjcb_passive(wall)  # readings are of the engine's last state, with its forces
    try:
        while now < min(ends, seconds + 8.0):
            step = made.step(q, wrenches=plant.measured_wrenches())
            says = step.status is Status.HOLDING and "the object touches something" in step.reason
            named = min(named, now) if says else named
            unnamed += now >= named and not says
            if np.isinf(wall.touched):
                braking = float(np.abs(step.velocity).max()) / case.acceleration
            q = plant.apply(step)
            now += step.dt
            wall.look(now)
            ends = wall.touched + 1.2
    finally:
        mujoco.set_mjcb_passive(None)
    at, size = np.array(wall.seen).T
    touched, moving = wall.touched, wall.energy / case.speed**2  # the mass that moves at its speed
    at, size = np.array(wall.seen).T
    touched, moving = wall.touched, wall.energy / case.speed**2  # the mass that moves at its speed
    stiff, damp = impedance(task, way)
    until = case.late + 3.0 * case.dt + 0.5 * braking  # until it is read, answered, and the joints have braked
    soft = case.spring * until + 4.0 * wall.damp
    limit = max(25.0, 0.2 * 9.81 * case.mass)  # what counts as a contact
    bound = limit + case.speed * min(soft, np.sqrt(case.spring * moving) + damp + stiff * until)
    late = 1e3 * (named - touched + case.dt)
    stands = float(size[at >= touched + STANDS].max())
    return Met(float(size.max()), stands if np.isfinite(named) else np.inf, float(bound), float(late), unnamed)


def cases(number: int) -> list[Case]:
    """Cases at random."""
    rng, names = np.random.default_rng(0), list(WAYS)
    return [
        Case(
            speed=float(np.exp(rng.uniform(np.log(0.03), np.log(0.25)))),
            late=float(rng.uniform(0.0, 0.02)),
            dt=float(rng.choice([0.002, 0.005, 0.0075, 0.01])),
            way=names[i % len(names)],
            mass=float(rng.uniform(5.0, 20.0)),
            spring=float(np.exp(rng.uniform(np.log(1e5), np.log(3e6)))),
            acceleration=float(rng.choice([10.0, 30.0, np.inf])),
            edge=bool(rng.random() < 0.3),
        )
        for i in range(number)
    ]


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    two = [Case(speed=0.063, late=0.0, dt=0.005), Case(speed=0.125, late=0.01, dt=0.0075)]
    met = [meet(case) for case in (*two, *([] if quick else cases(24)))]
    name = "contact 40 mm too early, 30 to 250 mm/s, wrenches to 20 ms late, steps to 10 ms"
    yield Promise(f"{name}: force from 0.3 s after it on", max(m.stands for m in met), 100.0, "N")
    yield Promise(f"{name}: steps that do not hold and name it", sum(m.unnamed for m in met), 0.0, "")
    yield Promise(f"{name}: time until it is named", max(m.late for m in met), 60.0, "ms")
    yield Promise(
        f"{name}: peak over limit + v min(k t, √(k m) + D + K t)", max(m.peak / m.bound for m in met), 1.0, ""
    )
    slow = meet(Case(speed=0.001, late=0.01, dt=0.005, early=0.001))
    yield Promise("contact at 1 mm/s, wrenches 10 ms late: peak", slow.peak, 100.0, "N")
