"""Settings of the physics plant: the servos and the engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin

from coopqp.checks import Doc, as_count, as_vector, documented, keep_scalars, one_each, read_only
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.cell import RobotCell
from coopqp.model.links import joint_axes
from coopqp.planning.payload import Payload
from coopqp.spatial import Array

Interpolation = Literal["linear", "cubic"]
GripPoints = Literal["grasp", "where they are"]
#: Kinds of drives of the joints; the laws of torque are in :mod:`coopqp.simulation.plants.drives`.
Servo = Literal["position", "computed torque", "disturbance observer"]
SERVOS: tuple[Servo, ...] = ("position", "computed torque", "disturbance observer")
#: Largest accepted product of a gain of torque-controlled drives and the delay in its loop.
_STEADY = 0.5

#: Servos of a large six-joint arm, from base to wrist. They are assumed: no maker publishes them. Forces scale with kp.
STIFFNESS = (1e5, 1e5, 5e4, 1e4, 1e4, 5e3)  # kp [N·m/rad]
DAMPING = (3160.0, 3160.0, 1265.0, 167.0, 167.0, 71.0)  # kd [N·m·s/rad]
ARMATURE = (5.0, 5.0, 3.0, 0.5, 0.5, 0.2)  # [kg·m²]
#: Servos of prismatic joints: kp [N/m], kd [N·s/m], moved mass of the drive [kg].
PRISMATIC_SERVO = (1e6, 2e4, 20.0)


@documented
@dataclass(frozen=True, kw_only=True, eq=False)
class PhysicsOptions:
    """Settings of the servos and the engine."""

    timestep: Annotated[
        float,
        Doc(
            "longest step of the engine [s]; a command of 'dt' takes 'ceil(dt / timestep)' equal steps, "
            "so 'dt' may have any length"
        ),
    ] = 1e-3
    settle: Annotated[float, Doc("time that a reset holds the start, until welds and servos are at rest [s]")] = 1.0
    hand_over: Annotated[
        float,
        Doc(
            "time in which the servo targets then move to the measured configuration, and again the time "
            "to come to rest there [s]; a controller starts there without a jump of its first command. 0 "
            "switches it off"
        ),
    ] = 0.25
    stiffness: Annotated[
        Any, Doc("kp of the joint servos [N·m/rad or N/m]; one number, one per joint (nv,), or None for the defaults")
    ] = None
    damping: Annotated[Any, Doc("kd of the joint servos [N·m·s/rad or N·s/m], in the same forms")] = None
    armature: Annotated[Any, Doc("inertia of the drives at the joints [kg·m² or kg], in the same forms")] = None
    servo: Annotated[
        Servo,
        Doc(
            '"position" for stiff position servos (stiffness, damping); "computed torque" for torques from a model of '
            'the arms; "disturbance observer" for the same with an observer of what the model gets wrong'
        ),
    ] = "position"
    loop_bandwidth: Annotated[
        float, Doc("ω of torque-controlled drives [rad/s]: errors of a joint follow 'ë + 2ω ė + ω² e = 0'")
    ] = 30.0
    observer_bandwidth: Annotated[float, Doc("K of the disturbance observer [rad/s]; its time constant is 1/K")] = 40.0
    wrist_sensors: Annotated[
        bool,
        Doc(
            "the disturbance observer reads force and torque sensors at the tools. Without them it cannot tell a wrong "
            "mass of an arm from a squeeze"
        ),
    ] = False
    torque_limits: Annotated[
        Any,
        Doc(
            "largest torques of torque-controlled drives [N·m or N]; one number, one per joint (nv,), or None for "
            "those of the models"
        ),
    ] = None
    assumed_mass: Annotated[
        float, Doc("masses and inertias of the links as the drives know them, as a multiple of the real ones")
    ] = 1.0
    assumed_payload: Annotated[
        float, Doc("the load that the drives feed forward, as a multiple of what it is said to be")
    ] = 1.0
    interpolation: Annotated[
        Interpolation,
        Doc(
            'interpolation of the joint targets within a command. "cubic" has a continuous velocity; it '
            "is causal, so after a velocity jump it overshoots by up to half the jump within one command"
        ),
    ] = "cubic"
    velocity_feed_forward: Annotated[
        bool, Doc("servos also get the velocity of the target; otherwise they lag by kd/kp times it")
    ] = True
    gravity_compensation: Annotated[bool, Doc("the drives carry the weight of the arms")] = True
    load_feed_forward: Annotated[
        bool, Doc("the drives carry the weight of the object, Jᵀf with the share of each arm")
    ] = True
    load_shares: Annotated[
        tuple[float, ...] | None,
        Doc(
            "share of the object's weight per arm (N,) with sum 1; by default the shares of least norm "
            "that balance the moments"
        ),
    ] = None
    gravity: Annotated[tuple[float, float, float], Doc("acceleration of gravity in world axes [m/s²]")] = (
        0.0,
        0.0,
        -9.81,
    )
    grips: Annotated[
        GripPoints,
        Doc(
            'placements of the welds: "grasp" uses the placements of the grasp (the object has its own '
            'grip points); "where they are" uses the placements of the tools at reset'
        ),
    ] = "grasp"
    weld_solref: Annotated[
        tuple[float, float],
        Doc("parameter solref of the engine's welds; the engine's default stretches by 0.36 mm under these loads"),
    ] = (0.004, 1.0)
    weld_solimp: Annotated[tuple[float, float, float, float, float], Doc("parameter solimp of the engine's welds")] = (
        0.9999,
        0.9999,
        0.001,
        0.5,
        2.0,
    )
    tolerance: Annotated[float, Doc("tolerance of the engine's Newton solver")] = 1e-12
    iterations: Annotated[int, Doc("largest number of iterations of the engine's Newton solver")] = 100

    def __post_init__(self) -> None:
        where = "PhysicsOptions"
        keep_scalars(self, "timestep", high=0.1)
        keep_scalars(self, "settle", "hand_over", open_low=False)
        keep_scalars(self, "tolerance")
        for name, size in (("gravity", 3), ("weld_solref", 2), ("weld_solimp", 5)):
            object.__setattr__(self, name, tuple(as_vector(getattr(self, name), size, f"{where}: {name}").tolist()))
        if self.interpolation not in ("linear", "cubic"):
            raise UnknownNameError("interpolation", str(self.interpolation), ("linear", "cubic"), where)
        if self.grips not in ("grasp", "where they are"):
            raise UnknownNameError("place to grip", str(self.grips), ("grasp", "where they are"), where)
        if self.servo not in SERVOS:
            raise UnknownNameError("servo", str(self.servo), SERVOS, where)
        keep_scalars(self, "loop_bandwidth", "observer_bandwidth", "assumed_mass", high=1e4)
        keep_scalars(self, "assumed_payload", high=1e4, open_low=False)
        self.check_rate()
        object.__setattr__(self, "iterations", as_count(self.iterations, f"{where}: iterations"))

    def check_rate(self, wrench_latency: float = 0.0) -> None:
        """Refuse bandwidths that sampled torques cannot hold.

        Args:
            wrench_latency: age of the wrenches of ``wrist_sensors`` [s].

        A single joint whose drives assume the mass ρ m in place of m swings without end where, with the observer,
        K ω = ρ (2ω + K) (ω + 2K) (Routh), where max(1, ρ) (2ω + K) timestep reaches 1.6, and where K times the age of
        the wrenches reaches π/2.

        Raises:
            InvalidInputError: K ω / (ρ (2ω + K) (ω + 2K)), max(1, ρ) (2ω + K) timestep (K = 0 without observer), or
                with wrist sensors K (wrench_latency + timestep), is above ½.
        """
        if self.servo == "position":
            return
        watches = self.servo == "disturbance observer"
        gain, named = 2.0 * self.loop_bandwidth, "2 loop_bandwidth"
        if watches:
            gain, named = gain + self.observer_bandwidth, f"({named} + observer_bandwidth)"
        rules = {f"max(1, assumed_mass) {named} timestep": max(1.0, self.assumed_mass) * gain * self.timestep}
        if watches:
            w, K = self.loop_bandwidth, self.observer_bandwidth
            rules["K ω / (assumed_mass (2ω + K) (ω + 2K))"] = (
                K * w / (self.assumed_mass * (2.0 * w + K) * (w + 2.0 * K))
            )
        if watches and self.wrist_sensors:
            late = self.observer_bandwidth * (wrench_latency + self.timestep)
            rules["observer_bandwidth (wrench_latency + timestep)"] = late
        for rule, size in rules.items():
            if size > _STEADY * (1.0 + 1e-12):
                raise InvalidInputError(
                    f"torques would swing: {rule} is {size:.3g}, and may be {_STEADY:g}",
                    "PhysicsOptions",
                    "Lower the bandwidths or timestep, or correct assumed_mass.",
                )

    def limits(self, cell: RobotCell) -> Array:
        """Largest torques of torque-controlled drives (nv,); inf for none.

        Raises:
            InvalidInputError: wrong shape, or a number is not positive.
        """
        if self.torque_limits is None:
            return read_only(Payload(mass=0.0).limits(cell))
        row = one_each(self.torque_limits, cell.nv, "PhysicsOptions: torque_limits")
        if not (row > 0.0).all():
            raise InvalidInputError(f"{row.tolist()} must be > 0", "PhysicsOptions: torque_limits", "Correct its sign.")
        return read_only(row)

    def servos(self, cell: RobotCell) -> Servos:
        """The servos of a cell's joints.

        Raises:
            InvalidInputError: wrong shape, or a number is not positive (an armature may be 0).
        """
        default = np.empty((3, cell.nv))
        for arm, columns in zip(reversed(cell.arms), reversed(cell.columns), strict=True):
            default[:, columns] = _default_servos(arm.model)  # a joint that arms share has those of the first of them
        given = (self.stiffness, self.damping, self.armature)
        rows = []
        for i, (name, value) in enumerate(zip(("stiffness", "damping", "armature"), given, strict=True)):
            row = default[i] if value is None else one_each(value, cell.nv, f"PhysicsOptions: {name}")
            if (row < 0.0).any() or (i < 2 and (row == 0.0).any()):
                raise InvalidInputError(f"{row.tolist()} must be > 0", f"PhysicsOptions: {name}", "Correct its sign.")
            rows.append(read_only(row))
        return Servos(*rows)


@dataclass(frozen=True, eq=False)
class Servos:
    """kp, kd and armature of the servos, (nv,) each; units as in :class:`PhysicsOptions`."""

    stiffness: Array
    damping: Array
    armature: Array


def _default_servos(model: pin.Model) -> Array:
    """kp, kd, armature (3, nv) of an arm, interpolated along the arm from the six-joint table."""
    n = model.nv
    place = np.linspace(0.0, 5.0, n) if n > 1 else np.zeros(1)
    below = np.minimum(place.astype(int), 4)
    share, table = place - below, np.array([STIFFNESS, DAMPING, ARMATURE])
    values = table[:, below] ** (1.0 - share) * table[:, below + 1] ** share
    slides = ~joint_axes(model)[:, 3:].any(axis=1)
    values[:, slides] = np.array(PRISMATIC_SERVO)[:, None]
    return np.asarray(values)
