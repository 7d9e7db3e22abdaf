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

from coopqp.checks import ArrayLike, as_options, as_scalar, as_tuple, as_vector, read_only, require
from coopqp.control.command import ControlStep
from coopqp.errors import CoopqpError, InvalidInputError, UnreachableError
from coopqp.forces.grips import Grip
from coopqp.forces.load import LoadShare
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.simulation.plants.drives import TorqueDrives
from coopqp.simulation.plants.encoders import Encoders
from coopqp.simulation.plants.mujoco_model import (
    OBJECT,
    STAND,
    STAND_HALF,
    build_spec,
    compile_spec,
    grip_site,
    placement,
    quaternion,
    require_mujoco,
    tool_site,
)
from coopqp.simulation.plants.physics_options import PhysicsOptions
from coopqp.simulation.plants.targets import JointTargets
from coopqp.simulation.plants.wrench_sensors import WrenchSensors
from coopqp.spatial import Array, Placement, as_placement, cross
from coopqp.task.path import TimeLaw

if TYPE_CHECKING:
    from coopqp.task.scenario import Scenario

__all__ = ["PhysicsError", "PhysicsOptions", "PhysicsPlant"]


#: Time in which the drives take the load over from the stand, once all palms press with their least squeeze [s].
_TAKES = 0.3


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
        disturbances: as in :class:`coopqp.simulation.plants.disturbed.DisturbedPlant`; lag and stall act on the
            targets of the servos, base offsets on the bases in the engine.
        load: load sharing whose torques the drives feed forward for the motion as commanded, with the arms' own
            dynamics, in place of the object's weight alone.

        palms: palms that press on the box in place of welds, one per arm: square pads around their discs, with contacts
            and friction. The box lies on a smooth stand, its z axis up, until the first command with a rate above 0.
            The drives take over its load as soon as all palms press with their ``squeeze``.

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
    ) -> None:
        mujoco = require_mujoco()
        require(grasp, Grasp, "PhysicsPlant: grasp", "Give a Grasp of the placements.")
        grasp.check_arms(cell)
        self._mujoco = mujoco
        self.cell, self.grasp = cell, grasp
        self.options = as_options(PhysicsOptions, options, "PhysicsPlant: options")
        self.disturbances = as_options(Disturbances, disturbances, "PhysicsPlant: disturbances")
        self._real_grasp = grasp if real_grasp is None else real_grasp
        self._real_grasp.check_arms(cell)
        size = as_vector(object_size, 3, "PhysicsPlant: object_size")
        if not (size > 0.0).all():
            raise InvalidInputError(f"{size.tolist()} must be > 0", "PhysicsPlant: object_size", "Give lengths [m].")
        self._object_size = size
        self.object_mass = as_scalar(object_mass, "PhysicsPlant: object_mass")
        self.T_object_body = (
            pin.SE3.Identity() if T_object_body is None else as_placement(T_object_body, "PhysicsPlant: T_object_body")
        )
        if load is not None:
            require(load, LoadShare, "PhysicsPlant: load", "Give a coopqp.forces.LoadShare.")
            if load.cell.joint_names != cell.joint_names:
                raise InvalidInputError(
                    "it shares the load of other arms", "PhysicsPlant: load", "Build it of the cell."
                )
            if not np.allclose(load.cell.model.gravity.linear, self.options.gravity):
                raise InvalidInputError("its gravity is another one", "PhysicsPlant: load", "Set cell.model.gravity.")
        self.load = load
        self.palms = None if palms is None else as_tuple(palms, "PhysicsPlant: palms", "Give one Grip per arm.")
        if self.palms is not None and (
            len(self.palms) != len(cell) or any(not isinstance(p, Grip) or p.kind != "palm" for p in self.palms)
        ):
            raise InvalidInputError("no palm for each arm", "PhysicsPlant: palms", 'Give Grip(kind="palm", …).')
        if self.palms is not None and not self.servoed:
            raise InvalidInputError(
                f"palms on drives by {self.options.servo}", "PhysicsPlant", 'Palms need servo="position".'
            )
        servos = self.options.servos(cell)
        self.stiffness, self._armature = servos.stiffness, servos.armature
        self._lead = servos.damping / servos.stiffness if self.options.velocity_feed_forward else np.zeros(cell.nv)
        self._load, self._data = self._load_wrenches(), cell.model.createData()
        self._spec = build_spec(
            cell,
            grasp,
            object_size=size,
            object_mass=self.object_mass,
            T_object_body=self.T_object_body,
            servos=servos,
            options=self.options,
            base_offset={
                cell.arm_names[cell.index(k)]: as_placement(T, "base_offset")
                for k, T in self.disturbances.base_offset.items()
            },
            palms=None if self.palms is None else dict(zip(cell.arm_names, self.palms, strict=True)),
        )
        self.mj_model = compile_spec(self._spec)
        self.mj_data = mujoco.MjData(self.mj_model)
        self._index()
        self._drives: TorqueDrives | None = None
        self.options.check_rate(self.disturbances.wrench_latency)
        if not self.servoed:
            self._drives = TorqueDrives(cell, grasp, self.options, self._armature, self.options.limits(cell))
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
        self.time, self._fresh = 0.0, False
        self._torque, self._velocity = np.zeros(cell.nv), np.zeros(cell.nv)
        self._limited, self._clock = np.zeros(cell.nv, dtype=bool), 0.0
        self._placed: list[pin.SE3] | None = None
        self._taken = 1.0 if self.palms is None else 0.0  # share of the load that the drives feed forward

    @staticmethod
    def of(
        scenario: Scenario,
        *,
        real_grasp: Grasp | None = None,
        options: PhysicsOptions | Mapping[str, Any] | None = None,
        disturbances: Disturbances | None = None,
        load: LoadShare | None = None,
        palms: Sequence[Grip] | None = None,
    ) -> PhysicsPlant:
        """Build the plant of a scenario from its cell, grasp and object."""
        return PhysicsPlant(
            scenario.cell,
            scenario.grasp,
            object_size=scenario.object_size,
            object_mass=scenario.object_mass,
            T_object_body=scenario.T_object_body,
            real_grasp=real_grasp,
            options=options,
            disturbances=disturbances,
            load=load,
            palms=palms,
        )

    # -- the plant -----------------------------------------------------------------------------------------------

    def reset(self, q: ArrayLike) -> Array:
        """Command ``q`` (nq,), close the grips and settle for ``options.settle``. Returns the measured configuration.

        If the grip points do not fit (offsets, ``grips="grasp"``), the welds pull the arms to them against the servos.
        The measured configuration contains this deflection; :meth:`coopqp.Grasp.from_configuration` can latch it.
        Within ``options.hand_over`` the servo targets then move to the measured configuration, the start of a
        controller. The returned configuration (nq,) has no noise: at rest, noise averages out.
        """
        start = self.cell.check_configuration(q, "PhysicsPlant.reset")
        m, d = self.mj_model, self.mj_data
        self._mujoco.mj_resetData(m, d)
        x = self.cell.positions(start)
        d.qpos[self._q_at] = x
        self._mujoco.mj_kinematics(m, d)
        self._grip([self._site(s) for s in self._tool_sites])
        self._placed = None
        self._taken = 1.0 if self.palms is None else 0.0
        self.time = 0.0
        h = m.opt.timestep = self.options.timestep
        still, torque = np.zeros(self.cell.nv), self._load_torque(start)
        if self._drives is not None:
            self._drives.reset()
            self._drive_sensors.reset()
            self._clock = 0.0
        self._limited = np.zeros(self.cell.nv, dtype=bool)
        self._command(x, still, still, torque)
        for _ in range(round(self.options.settle / h)):
            self._step()
            if self._drives is not None:
                self._command(x, still, still, torque)
        measured = self._configuration()
        self._encoders.reset(measured)
        self._wrench_sensors.reset()
        self._torque = self._load_torque(measured)
        n, way = round(self.options.hand_over / h), pin.difference(self.cell.model, start, measured)
        for i in range(2 * n):
            u = TimeLaw.QUINTIC.value_at((i + 1) / n)  # half the steps to move, half to rest
            self._command(x + u * way, still, still, torque + u * (self._torque - torque))
            self._step()
        self._targets.reset(measured if n else start)
        self._velocity = np.zeros(self.cell.nv)
        return measured

    def apply(self, step: ControlStep) -> Array:
        """Drive the joints to ``step.q_next`` in ``step.dt``. Returns the measured configuration (nq,) at the end."""
        dt = as_scalar(step.dt, "PhysicsPlant.apply: step.dt")
        q_next = self.cell.check_configuration(step.q_next, "PhysicsPlant.apply: step.q_next")
        m, targets = self.mj_model, self._targets
        targets.push(q_next, dt)
        if self.palms is not None and self._placed is None:
            pressed = zip(self.palms, self.sensed_wrenches(), strict=True)
            if all(w[:3] @ palm.normal > palm.squeeze for palm, w in pressed):
                self._taken = min(self._taken + dt / _TAKES, 1.0)
        if self.palms is not None and self._placed is None and step.rate > 0.0:
            self._taken = 1.0
            self._placed = self._tools_on_object()
            m.geom_contype[self._stand] = m.geom_conaffinity[self._stand] = 0
        before, after = self._torque, self._load_torque(q_next, step.velocity, (step.velocity - self._velocity) / dt)
        self._velocity = np.array(step.velocity)
        n = max(1, math.ceil(dt / self.options.timestep - 1e-9))
        h = m.opt.timestep = dt / n
        self._limited[:] = False
        for i in range(n):
            now = self.time + i * h
            self._grow(now)
            self._command(*targets.at(now), targets.acceleration(now), before + (i / n) * (after - before))
            self._step()
        self.time = targets.end
        # Readings then refer to the present time.
        self._command(*targets.at(self.time), targets.acceleration(self.time), after)
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
        self.mj_data.eq_active[self._welds] = 0
        self._fresh = False

    @property
    def gripped(self) -> bool:
        """True while every arm holds the object, or touches it with its palm; recordings say it."""
        if self.palms is not None:
            return bool((np.linalg.norm(self.sensed_wrenches()[:, :3], axis=1) > 1e-6).all())
        return bool(self.mj_data.eq_active[self._welds].all())

    # -- readings ------------------------------------------------------------------------------------------------

    def wrenches(self) -> Array:
        """Wrench of each arm on the object (N, 6) [N, N·m], at the origin and in the axes of the object frame.

        The values come from the weld constraints; they are zero for an open grip. See
        :func:`coopqp.forces.stress.at_tools`.
        """
        self._refresh()
        if self.palms is None:
            return self._at_welds()
        placed = zip(self._tools_on_object(), self._sensed(), strict=True)
        return np.array([X.actionInverse.T @ w for X, w in placed])

    def _at_welds(self) -> Array:
        """The wrenches of the weld constraints, as the engine left them."""
        m, d = self.mj_model, self.mj_data
        R = d.xmat[self._object].reshape(3, 3)
        J = d.efc_J.reshape(d.nefc, m.nv)[:, self._object_dofs]
        equality = d.efc_type == int(self._mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        out = np.zeros((len(self.cell), 6))
        for k, weld in enumerate(self._welds):
            rows = equality & (d.efc_id == weld)
            generalized = J[rows].T @ d.efc_force[rows]  # force in world axes, torque in body axes
            out[k, :3], out[k, 3:] = R.T @ generalized[:3], generalized[3:]
        return out

    def sensed_wrenches(self) -> Array:
        """Wrench of each arm on the object from the tools' force and torque sensors (N, 6) [N, N·m].

        Each wrench is at the origin and in the axes of the tool. Before version 4 the engine's torque sensors misread
        welds under load; the torques of the welds then take their place.
        """
        self._refresh()
        return self._sensed()

    def _sensed(self) -> Array:
        felt = np.array([self.mj_data.sensordata[rows] for rows in self._sensors])
        if self._misreads:
            placed = zip(self._tools_placed(), self._at_welds(), strict=True)
            felt[:, 3:] = [(X.action.T @ w)[3:] for X, w in placed]
        return felt

    def slip(self) -> float:
        """How far any palm has slipped along the object since the stand let it go [m]; 0 before."""
        if self.palms is None or self._placed is None:
            return 0.0
        far = 0.0
        for palm, before, now in zip(self.palms, self._placed, self._tools_on_object(), strict=True):
            way, normal = now.translation - before.translation, before.rotation @ palm.normal
            far = max(far, float(np.linalg.norm(way - (way @ normal) * normal)))
        return far

    def _tools_on_object(self) -> list[pin.SE3]:
        self._refresh()
        return self._tools_placed()

    def _tools_placed(self) -> list[pin.SE3]:
        """T_object_tool of every arm, as the engine left them."""
        O = placement(self.mj_data.xpos[self._object], self.mj_data.xmat[self._object])
        return [O.actInv(self._site(s)) for s in self._tool_sites]

    def measured_wrenches(self) -> Array:
        """The same as the controller gets it, by the disturbances; NaN for an arm whose wrench is lost."""
        return self._wrench_sensors.read(self.sensed_wrenches(), self.time)

    @property
    def servo_torques(self) -> Array:
        """Torques or forces of the servos (nv,) [N·m or N], without the feed-forward of gravity and load."""
        self._refresh()
        if self._drives is not None:
            return np.array(self._drives.feedback)
        return np.array(self.mj_data.actuator_force[self._actuators])

    @property
    def joint_torques(self) -> Array:
        """All that the drives give (nv,) [N·m or N]: servos, feed-forward, the arms' own weight."""
        self._refresh()
        d = self.mj_data
        return np.array((d.qfrc_actuator + d.qfrc_applied + d.qfrc_gravcomp)[self._v_at])

    @property
    def limited_joints(self) -> tuple[str, ...]:
        """Joints whose torque was cut to its limit in the last command; position servos have no limits."""
        return tuple(name for name, cut in zip(self.cell.joint_names, self._limited, strict=True) if cut)

    @property
    def T_world_object(self) -> pin.SE3:
        """Real pose of the object."""
        self._refresh()
        return placement(self.mj_data.xpos[self._object], self.mj_data.xmat[self._object])

    @property
    def T_world_tool(self) -> tuple[pin.SE3, ...]:
        """Real placements of the tools."""
        self._refresh()
        return tuple(self._site(s) for s in self._tool_sites)

    @property
    def positions(self) -> Array:
        """Real joint positions without noise (nv,) [rad or m]; continuous joints count beyond ±π."""
        return np.array(self.mj_data.qpos[self._q_at])

    def xml(self) -> str:
        """The model as MJCF text, as built (reset places the grips)."""
        return str(self._spec.to_xml())

    # -- inside --------------------------------------------------------------------------------------------------

    def _index(self) -> None:
        """Look up the indices in MuJoCo's arrays."""
        m, names = self.mj_model, self.cell.arm_names
        joints = [m.joint(name) for name in self.cell.joint_names]
        self._q_at = np.array([j.qposadr[0] for j in joints])
        self._v_at = np.array([j.dofadr[0] for j in joints])
        self._actuators = np.array([m.actuator(name).id for name in self.cell.joint_names])
        self._tool_sites = [m.site(tool_site(name)).id for name in names]
        self._grip_sites = [m.site(grip_site(name)).id for name in names]
        welded = [] if self.palms is not None else names
        self._welds = np.array([m.equality(tool_site(name)).id for name in welded], dtype=int)
        self._stand = m.geom(STAND).id if self.palms is not None else -1
        starts = [(m.sensor(f"{name}:force").adr[0], m.sensor(f"{name}:torque").adr[0]) for name in names]
        self._sensors = [[*range(f, f + 3), *range(t, t + 3)] for f, t in starts]
        self._misreads = self.palms is None and int(self._mujoco.__version__.partition(".")[0]) < 4
        self._object = m.body(OBJECT).id
        free = m.joint(OBJECT)
        self._object_q = slice(free.qposadr[0], free.qposadr[0] + 7)
        self._object_dofs = slice(free.dofadr[0], free.dofadr[0] + 6)

    def _grip(self, tools: list[pin.SE3]) -> None:
        """Place the object according to the first arm, and the grip points according to ``options.grips``."""
        m, d, real = self.mj_model, self.mj_data, list(self._real_grasp.T_object_tool)
        O = tools[0] * real[0].inverse()
        if self.options.grips == "where they are":
            real = [O.actInv(T) for T in tools]
        d.qpos[self._object_q] = [*O.translation, *quaternion(O.rotation)]
        if self.palms is not None:
            deep = 0.5 * self._object_size[2] + STAND_HALF
            stand = O * self.T_object_body * pin.SE3(np.eye(3), np.array([0.0, 0.0, -deep]))
            body = m.body(STAND).id
            m.body_pos[body], m.body_quat[body] = stand.translation, quaternion(stand.rotation)
            m.body_sameframe[body] = self._mujoco.mjtSameFrame.mjSAMEFRAME_NONE
            m.geom_contype[self._stand], m.geom_conaffinity[self._stand] = 1, 2
        self._gripped_at = np.zeros((len(real), 3))
        for k, (s, X) in enumerate(zip(self._grip_sites, real, strict=True)):
            m.site_pos[s], m.site_quat[s] = X.translation, quaternion(X.rotation)
            self._gripped_at[k] = X.translation
            m.site_sameframe[s] = self._mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # or MuJoCo may ignore the new place

    def _grow(self, time: float) -> None:
        """Move the grips with the object's size at a time since the start [s]."""
        growth = 0.0 if self.palms is not None else self.disturbances.object_growth
        if growth != 0.0:
            size = 1.0 + growth * math.sin(2.0 * math.pi * time / self.disturbances.growth_period)
            self.mj_model.site_pos[self._grip_sites] = size * self._gripped_at

    def _load_wrenches(self) -> Array:
        """Each arm's share in carrying the object's weight, (N, 6): force in world axes [N], then lever [m].

        The lever is in object axes. Lever × weight is the arm's part of the moment that the forces leave unbalanced.
        """
        options, n = self.options, len(self.cell)
        points = np.array([X.translation for X in self.grasp.T_object_tool])
        centre = self.T_object_body.translation
        if options.load_shares is None:
            system = np.vstack([np.ones(n), (points - centre).T])
            shares = np.linalg.lstsq(system, np.array([1.0, 0.0, 0.0, 0.0]), rcond=1e-9)[0]
            total = float(shares.sum())
            shares = shares / total if abs(total) > 1e-6 else np.full(n, 1.0 / n)
        else:
            shares = as_vector(options.load_shares, n, "PhysicsOptions: load_shares")
            if abs(float(shares.sum()) - 1.0) > 1e-9:
                raise InvalidInputError(
                    f"load_shares {shares.tolist()} do not sum to 1", "PhysicsOptions", "Give shares of the weight."
                )
        lever = centre - shares @ points
        weight = -self.object_mass * np.array(options.gravity)
        return np.array([np.concatenate([share * weight, lever / n]) for share in shares])

    def _load_torque(self, q: Array, velocity: Array | None = None, acceleration: Array | None = None) -> Array:
        """Feed-forward torques (nv,) at ``q``, at rest by default, with the nominal cell and grasp.

        Jᵀf of the object's weight; with load sharing all that its motion takes, besides the weight that the drives
        carry anyhow. Torque-controlled drives know the arms' part by themselves.
        """
        out = np.zeros(self.cell.nv)
        if not self.options.load_feed_forward or self._taken == 0.0:
            return out
        if self.load is not None:
            v, dv = (out if x is None else x for x in (velocity, acceleration))
            twist, change = self.load.object_motion(q, v, dv)
            try:
                shared = self.load.share(q, twist=twist, acceleration=change, joint_velocity=v, joint_acceleration=dv)
            except UnreachableError:  # no torques for such an acceleration: feed forward what rest takes
                v = dv = out
                shared = self.load.share(q, joint_velocity=v, joint_acceleration=dv)
            load = self.options.assumed_payload * shared.load_torques
            if self._drives is not None:
                return self._taken * load
            if self.options.gravity_compensation:
                out = pin.computeGeneralizedGravity(self.cell.model, self._data, q)
            arms = self.options.assumed_mass * (shared.torques - shared.load_torques - out)
            return self._taken * (load + arms + self._armature * dv)
        J = np.asarray(pin.computeJointJacobians(self.cell.model, self._data, q))
        tools = [self._data.oMi[j] * X for j, X in zip(self.cell.tool_joints, self.cell.T_joint_tool, strict=True)]
        R_object = tools[0].rotation @ self.grasp.T_object_tool[0].rotation.T
        weight = -self.object_mass * np.array(self.options.gravity)
        forces, points = self._load[:, :3], np.array([T.translation for T in tools])
        # about the world's origin, like J
        moments = cross(self._load[:, 3:] @ R_object.T, weight[None]) + cross(points, forces)
        for k, s in enumerate(self.cell.v_slices):
            out[s] = forces[k] @ J[:3, s] + moments[k] @ J[3:, s]
        return self._taken * self.options.assumed_payload * out

    def _command(self, x: Array, v: Array, a: Array, torque: Array) -> None:
        """Targets of the joints and what is fed forward (nv,): positions, velocities, accelerations; torques."""
        d = self.mj_data
        if self._drives is None:
            d.ctrl[self._actuators] = x + self._lead * v
            d.qfrc_applied[self._v_at] = torque
        else:
            q, now = self._configuration(), np.array(d.qvel[self._v_at])
            d.ctrl[self._actuators] = self._drives.torque(q, now, x - self.positions, v - now, a, torque)
        self._fresh = False

    def _step(self) -> None:
        """One step of the engine with the last command; an observer sees what comes of it."""
        self._mujoco.mj_step(self.mj_model, self.mj_data)
        if self._drives is not None:
            self._limited |= self._drives.limited
            now = np.array(self.mj_data.qvel[self._v_at])
            # The engine's readings are those at the start of its step, when the torques began to act.
            self._clock += self.mj_model.opt.timestep
            felt = self._drive_sensors.read(self._sensed(), self._clock)
            self._drives.observe(self._configuration(), now, self.mj_model.opt.timestep, felt)

    def _configuration(self) -> Array:
        """Real configuration (nq,)."""
        x = self.positions
        if not np.isfinite(x).all():
            raise PhysicsError(
                f"the engine diverged at {self.time:.3f} s: its positions are not finite. Check the command, or lower "
                "the servos' stiffness or the time step."
            )
        return self.cell.configuration(x)

    def _site(self, site: int) -> pin.SE3:
        return placement(self.mj_data.site_xpos[site], self.mj_data.site_xmat[site])

    def _refresh(self) -> None:
        """Evaluate the engine at the present state and command, without an effect on its next steps."""
        if self._fresh:
            return
        start = self.mj_data.qacc_warmstart.copy()
        self._mujoco.mj_forward(self.mj_model, self.mj_data)
        self.mj_data.qacc_warmstart[:] = start
        self._fresh = True
