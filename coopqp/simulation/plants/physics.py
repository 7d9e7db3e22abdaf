"""The physics plant: the cell in MuJoCo. The object is a body with mass, welded to the tools.

Position servos drive the joints, or torques by a model of the arms (:mod:`coopqp.simulation.plants.drives`).

The object and the links are rigid, the welds nearly so. A command that does not fit the grasp deflects the servos and
stresses the object. The plant reads the forces at the grasps. They scale with the stiffness of the servos, so quote it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_options, as_scalar, as_vector, read_only, require
from coopqp.control.interface import ControlStep, Status
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.forces.grips import Grip
from coopqp.forces.load_sharing import LoadShare
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.grasp_motion import HAND_OVER_S, GraspMotion
from coopqp.paths.time_law import TimeLaw
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.simulation.plants.drives import TorqueDrives
from coopqp.simulation.plants.load_feed_forward import LoadFeedForward
from coopqp.simulation.plants.mujoco_cell import MujocoCell
from coopqp.simulation.plants.mujoco_model import build_spec, require_mujoco
from coopqp.simulation.plants.palms import Palms, as_palms
from coopqp.simulation.plants.physics_options import PhysicsOptions
from coopqp.simulation.plants.sensors import Encoders, WrenchSensors
from coopqp.simulation.plants.targets import JointTargets
from coopqp.spatial import Array, Placement, as_placement

if TYPE_CHECKING:
    from coopqp.paths.scenario import Scenario

__all__ = ["PhysicsError", "PhysicsOptions", "PhysicsPlant"]


class PhysicsError(CoopqpError):
    """The engine diverged: its positions are not finite."""


@final
class PhysicsPlant:
    """A cell and the object it holds, in MuJoCo. Needs the extra ``mujoco``.

    The engine executes a command of any ``dt`` in ``ceil(dt / timestep)`` equal steps, so a command ends exactly when
    the next one begins. A ``dt`` below the time step shortens the engine's step.

    Args:
        cell: the arms as the controller knows them.
        grasp: the grasp as the controller knows it.
        object_size: side lengths of the box [m].
        object_mass: mass of the object [kg].
        T_object_body: placement of the box's centre in the object frame (identity by default).
        real_grasp: real placements of the tools on the object, if they differ from ``grasp``
            (:func:`coopqp.simulation.plants.disturbances.misplaced`).
        options: settings of the servos and the engine.
        disturbances: as in :class:`coopqp.simulation.plants.kinematic.DisturbedPlant`; lag and stall act on the
            targets of the servos, base offsets on the bases in the engine.
        load: load sharing whose torques the drives feed forward for the motion as commanded, with the arms' own
            dynamics, in place of the object's weight alone.
        palms: palms that press on the box in place of welds, one per arm: square pads around their discs, with contacts
            and friction. The box lies on a smooth stand, its z axis up, until the first command with a rate above 0.
            The drives take over its load as soon as all palms press with their ``squeeze``.
        holds: which arms hold the object at first (N,); by default all.

    Attributes:
        stiffness: kp of the servos (nv,) [N·m/rad or N/m]; of torque-controlled drives ω² times the inertia
            at each joint, all joints at zero.
        time: time since the last reset without settling [s].
        mj_model, mj_data: MuJoCo's objects, for viewers and other readings.

    Raises:
        MissingExtraError: mujoco is not installed.
        ModelError: the engine cannot represent an arm.
        InvalidInputError, UnknownNameError: bad settings.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        *,
        object_size: tuple[float, float, float],
        object_mass: float,
        T_object_body: Placement | None = None,
        real_grasp: Grasp | None = None,
        options: PhysicsOptions | Mapping[str, Any] | None = None,
        disturbances: Disturbances | None = None,
        load: LoadShare | None = None,
        palms: Sequence[Grip] | None = None,
        holds: Sequence[bool] | None = None,
    ) -> None:
        require_mujoco()
        require(grasp, Grasp, "PhysicsPlant: grasp", "Give a Grasp of the placements.")
        grasp.check_arms(cell)
        self.cell, self.grasp = cell, grasp
        self.options = as_options(PhysicsOptions, options, "PhysicsPlant: options")
        self.disturbances = as_options(Disturbances, disturbances, "PhysicsPlant: disturbances")
        self._real_grasp = grasp if real_grasp is None else real_grasp
        self._real_grasp.check_arms(cell)
        size = as_vector(object_size, 3, "PhysicsPlant: object_size")
        if not (size > 0.0).all():
            raise InvalidInputError(f"{size.tolist()} must be > 0", "PhysicsPlant: object_size", "Give lengths [m].")
        self.object_mass = as_scalar(object_mass, "PhysicsPlant: object_mass")
        self.T_object_body = (
            pin.SE3.Identity() if T_object_body is None else as_placement(T_object_body, "PhysicsPlant: T_object_body")
        )
        self.palms = None if palms is None else as_palms(palms, len(cell))
        if self.palms is not None and not self.servoed:
            raise InvalidInputError(
                f"palms on drives by {self.options.servo}", "PhysicsPlant", 'Palms need servo="position".'
            )
        servos = self.options.servos(cell)
        self.stiffness = servos.stiffness
        self._lead = servos.damping / servos.stiffness if self.options.velocity_feed_forward else np.zeros(cell.nv)
        self.load = load
        self._feed_forward = LoadFeedForward(
            cell,
            grasp,
            self.options,
            object_mass=self.object_mass,
            centre=self.T_object_body.translation,
            load=load,
            armature=servos.armature,
        )
        self._spec = build_spec(
            cell,
            grasp,
            object_size=size,
            object_mass=self.object_mass,
            T_object_body=self.T_object_body,
            servos=servos,
            options=self.options,
            base_offset=self.disturbances.base_offsets(cell),
            palms=None if self.palms is None else dict(zip(cell.arm_names, self.palms, strict=True)),
        )
        self._engine = MujocoCell(self._spec, cell, welded=self.palms is None)
        self.mj_model, self.mj_data = self._engine.model, self._engine.data
        self._palms = None if self.palms is None else Palms(self.palms, self._engine, self.T_object_body, size[2])
        self._drives: TorqueDrives | None = None
        self.options.check_rate(self.disturbances.wrench_latency)
        if not self.servoed:
            self._drives = TorqueDrives(cell, grasp, self.options, servos.armature, self.options.limits(cell))
            M, _ = self._drives.model_at(pin.neutral(cell.model), np.zeros(cell.nv))
            self.stiffness = read_only(self.options.loop_bandwidth**2 * np.diag(M))
        self._targets = JointTargets(
            cell,
            interpolation=self.options.interpolation,
            lag=self.disturbances.lag,
            stall=self.disturbances.stall,
        )
        self._encoders = Encoders(cell, self.disturbances)
        self._wrench_sensors = WrenchSensors(cell, self.disturbances)
        self._drive_sensors = WrenchSensors(cell, self.disturbances)  # the same, at the rate of the drives
        self.time, self._clock = 0.0, 0.0
        self._torque, self._velocity = np.zeros(cell.nv), np.zeros(cell.nv)
        self._limited = np.zeros(cell.nv, dtype=bool)
        #: Which arms hold the object: at first, and now.
        self._held_first = self._holds = (True,) * len(cell) if holds is None else tuple(map(bool, holds))
        if len(self._holds) != len(cell) or not any(self._holds):
            raise InvalidInputError(f"{holds}", "PhysicsPlant: holds", "Tell it of each arm; one holds at least.")

    @staticmethod
    def of(scenario: Scenario, **more: Any) -> PhysicsPlant:
        """Build the plant of a scenario from its cell, grasp and object, and the arms that hold it at first.

        Args:
            scenario: whose they are.
            more: further arguments, or others in place of the scenario's.
        """
        given = {name: getattr(scenario, name) for name in ("object_size", "object_mass", "T_object_body")}
        if (motion := scenario.path.grasps) is not None:
            given["holds"] = motion.holds(0.0)
        return PhysicsPlant(scenario.cell, scenario.grasp, **{**given, **more})

    # -- the plant -----------------------------------------------------------------------------------------------

    def reset(self, q: ArrayLike) -> Array:
        """Command ``q`` (nq,), close the grips and settle for ``options.settle``. Returns the measured configuration.

        If the grip points do not fit (offsets, ``grips="grasp"``), the welds pull the arms to them against the servos.
        The measured configuration contains this deflection; :meth:`coopqp.Grasp.from_configuration` can latch it.
        Within ``options.hand_over`` the servo targets then move to the measured configuration, the start of a
        controller. The returned configuration (nq,) has no noise: at rest, noise averages out.
        """
        start = self.cell.check_configuration(q, "PhysicsPlant.reset")
        x = self.cell.positions(start)
        self._engine.reset(x)
        O = self._engine.grip(self._real_grasp.T_object_tool, where_they_are=self.options.grips == "where they are")
        if self._palms is not None:
            self._palms.reset(O)
        self.time, self._holds = 0.0, self._held_first
        for k in np.flatnonzero(~np.array(self._holds)):
            self._engine.open(int(k))
        self._feed_forward.reset()
        if not all(self._holds):
            self._feed_forward.hand_over(self._holds, self.grasp, 1.0)
        h = self.options.timestep
        still, torque = np.zeros(self.cell.nv), self._load_torque(start)
        if self._drives is not None:
            self._drives.reset()
            self._drive_sensors.reset()
            self._clock = 0.0
        self._limited = np.zeros(self.cell.nv, dtype=bool)
        self._command(x, still, None, torque)
        for _ in range(round(self.options.settle / h)):
            self._step(h)
            if self._drives is not None:
                self._command(x, still, None, torque)
        measured = self._configuration()
        self._encoders.reset(measured)
        self._wrench_sensors.reset()
        self._torque = self._load_torque(measured)
        n, way = round(self.options.hand_over / h), pin.difference(self.cell.model, start, measured)
        for i in range(2 * n):
            u = TimeLaw.QUINTIC.value_at((i + 1) / n)  # half the steps to move, half to rest
            self._command(x + u * way, still, None, torque + u * (self._torque - torque))
            self._step(h)
        self._targets.reset(measured if n else start, self.positions)
        self._velocity = np.zeros(self.cell.nv)
        return measured

    def apply(self, step: ControlStep) -> Array:
        """Drive the joints to ``step.q_next`` in ``step.dt``. Returns the measured configuration (nq,) at the end."""
        dt = as_scalar(step.dt, "PhysicsPlant.apply: step.dt")
        q_next = self.cell.check_configuration(step.q_next, "PhysicsPlant.apply: step.q_next")
        if self.follows_contact and step.path.grasps is not None:
            self._take_contact(step, step.path.grasps, dt)
        targets = self._targets
        targets.push(q_next, dt)
        if self._palms is not None:
            self._palms.step(dt, step.rate)
        before, after = self._torque, self._load_torque(q_next, step.velocity, (step.velocity - self._velocity) / dt)
        self._velocity = np.array(step.velocity)
        n = max(1, math.ceil(dt / self.options.timestep - 1e-9))
        h = dt / n
        self._limited[:] = False
        for i in range(n):
            now = self.time + i * h
            self._grow(now)
            self._command(*targets.at(now), now, before + (i / n) * (after - before))
            self._step(h)
        self.time = targets.end
        # Readings then refer to the present time.
        self._command(*targets.at(self.time), self.time, after)
        self._torque = after
        return self._encoders.read(self._configuration(), dt)

    def period(self, nominal: float) -> float:
        """Length of the next step [s] with jitter; the loop passes it to the controller."""
        return self._encoders.period(nominal)

    @property
    def servoed(self) -> bool:
        """True if position servos drive the joints, False for torques by a model of the arms."""
        return self.options.servo == "position"

    def release(self) -> None:
        """Open all grips until the next reset. The object falls."""
        self._engine.open()

    @property
    def gripped(self) -> bool:
        """True while every arm that is to hold the object does, or touches it with its palm; recordings say it."""
        return self._engine.welds == self._holds if self._palms is None else self._palms.touch

    # -- readings ------------------------------------------------------------------------------------------------

    def wrenches(self) -> Array:
        """Wrench of each arm on the object (N, 6) [N, N·m], at the origin and in the axes of the object frame.

        The values come from the weld constraints; they are zero for an open grip. See
        :func:`coopqp.forces.internal.at_tools`.
        """
        if self.palms is None:
            return self._engine.weld_wrenches()
        placed = zip(self._engine.T_object_tool, self._engine.sensed_wrenches(), strict=True)
        return np.array([X.actionInverse.T @ w for X, w in placed])

    def sensed_wrenches(self) -> Array:
        """Wrench of each arm on the object from the tools' force and torque sensors (N, 6) [N, N·m].

        Each wrench is at the origin and in the axes of the tool. Before version 4 the engine's torque sensors misread
        welds under load; the torques of the welds then take their place.
        """
        return self._engine.sensed_wrenches()

    def slip(self) -> float:
        """Largest slip of a palm along the object since the stand let it go [m]; 0 before."""
        return 0.0 if self._palms is None else self._palms.slip()

    def measured_wrenches(self) -> Array:
        """The sensed wrenches (N, 6) with the disturbances, as the controller gets them; NaN for a lost one."""
        return self._wrench_sensors.read(self.sensed_wrenches(), self.time)

    @property
    def servo_torques(self) -> Array:
        """Torques or forces of the servos (nv,) [N·m or N], without the feed-forward of gravity and load."""
        return self._engine.actuator_torques if self._drives is None else np.array(self._drives.feedback)

    @property
    def joint_torques(self) -> Array:
        """All that the drives give (nv,) [N·m or N]: servos, feed-forward, the arms' own weight."""
        return self._engine.joint_torques

    @property
    def limited_joints(self) -> tuple[str, ...]:
        """Joints whose torque was cut to its limit in the last command; position servos have no limits."""
        return tuple(name for name, cut in zip(self.cell.joint_names, self._limited, strict=True) if cut)

    @property
    def T_world_object(self) -> pin.SE3:
        """Real pose of the object."""
        return self._engine.T_world_object

    @property
    def T_world_tool(self) -> tuple[pin.SE3, ...]:
        """Real placements of the tools."""
        return self._engine.T_world_tool

    @property
    def positions(self) -> Array:
        """Real joint positions without noise (nv,) [rad or m]; continuous joints count beyond ±π."""
        return self._engine.positions

    def xml(self) -> str:
        """The model as MJCF text, as built (reset places the grips)."""
        return str(self._spec.to_xml())

    # -- inside --------------------------------------------------------------------------------------------------

    @property
    def follows_contact(self) -> bool:
        """Whether arms let go and attach along a program: with welds, where each joint's drive has its own load."""
        return self._palms is None and self.load is None

    def _take_contact(self, step: ControlStep, motion: GraspMotion, dt: float) -> None:
        """Open and close the grips as the program says: each closes where its tool is.

        The drives hand the weight over ahead of a release and after an attachment, in HAND_OVER_S.
        """
        holds = motion.holds(step.clock)
        if step.status not in (Status.HOLDING, Status.FAULT):  # an arm that is not where it grasps does not attach
            for k, (wanted, held) in enumerate(zip(holds, self._holds, strict=True)):
                if wanted and not held:
                    self._engine.attach(k)
                elif held and not wanted:
                    self._engine.open(k)
            self._holds = holds
        soon = motion.holds(step.clock + step.sense * HAND_OVER_S) if step.sense else holds
        bears = tuple(a and b for a, b in zip(self._holds, soon, strict=True))
        placed = self.grasp.moved_by(motion.placements(step.clock))
        self._feed_forward.hand_over(bears if any(bears) else self._holds, placed, dt / HAND_OVER_S)

    def _grow(self, time: float) -> None:
        """Move the grips with the object's size at a time since the start [s]."""
        growth = 0.0 if self.palms is not None else self.disturbances.object_growth
        if growth != 0.0:
            size = 1.0 + growth * math.sin(2.0 * math.pi * time / self.disturbances.growth_period)
            self._engine.grow(size)

    def _load_torque(self, q: Array, velocity: Array | None = None, acceleration: Array | None = None) -> Array:
        """Feed-forward (nv,) for the part of the load that the drives have taken from the stand."""
        taken = 1.0 if self._palms is None else self._palms.taken
        if taken == 0.0:
            return np.zeros(self.cell.nv)
        return taken * self._feed_forward.torque(q, velocity, acceleration)

    def _command(self, x: Array, v: Array, at: float | None, torque: Array) -> None:
        """Targets of the joints (nv,): positions and velocities; and torques that are fed forward.

        Torque-controlled drives also get the targets' accelerations ``at`` a time [s]; None at rest.
        """
        if self._drives is None:
            self._engine.drive(x + self._lead * v, torque)
        else:
            a = np.zeros(self.cell.nv) if at is None else self._targets.acceleration(at)
            q, now = self._configuration(), self._engine.velocities
            self._engine.drive(self._drives.torque(q, now, x - self.positions, v - now, a, torque))

    def _step(self, h: float) -> None:
        """One step of the engine with the last command; an observer sees the result."""
        self._engine.step(h)
        if self._drives is not None:
            self._limited |= self._drives.limited
            self._clock += h
            felt = self._drive_sensors.read(self._engine.sensed_wrenches(of_last_step=True), self._clock)
            self._drives.observe(self._configuration(), self._engine.velocities, h, felt)

    def _configuration(self) -> Array:
        """Real configuration (nq,)."""
        x = self.positions
        if not np.isfinite(x).all():
            raise PhysicsError(
                f"the engine diverged at {self.time:.3f} s: its positions are not finite. Check the command, or lower "
                "the servos' stiffness or the time step."
            )
        return self.cell.configuration(x)
