"""The cell in the engine: state, inputs and readings of MuJoCo's model by the names of the cell."""

from __future__ import annotations

from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.simulation.plants.mujoco_model import (
    OBJECT,
    compile_spec,
    grip_site,
    placement,
    quaternion,
    require_mujoco,
    tool_site,
)
from coopqp.spatial import Array


@final
class MujocoCell:
    """The compiled model of a cell, and its state.

    Readings refer to the present state and command. :meth:`sensed_wrenches` can also read the last step.

    Args:
        spec: :func:`coopqp.simulation.plants.mujoco_model.build_spec`.
        cell: the arms.
        welded: welds join the tools to the object; otherwise palms press on it.

    Attributes:
        model, data: MuJoCo's objects.

    Raises:
        ModelError: the engine refuses the model.
    """

    def __init__(self, spec: Any, cell: RobotCell, *, welded: bool) -> None:
        self._mujoco = mujoco = require_mujoco()
        self.model = m = compile_spec(spec)
        self.data = mujoco.MjData(m)
        names = cell.arm_names
        joints = [m.joint(name) for name in cell.joint_names]
        self._q_at = np.array([j.qposadr[0] for j in joints])
        self._v_at = np.array([j.dofadr[0] for j in joints])
        self._actuators = np.array([m.actuator(name).id for name in cell.joint_names])
        self._tool_sites = [m.site(tool_site(name)).id for name in names]
        self._grip_sites = [m.site(grip_site(name)).id for name in names]
        self._welds = np.array([m.equality(tool_site(name)).id for name in names] if welded else [], dtype=int)
        starts = [(m.sensor(f"{name}:force").adr[0], m.sensor(f"{name}:torque").adr[0]) for name in names]
        self._sensors = [[*range(f, f + 3), *range(t, t + 3)] for f, t in starts]
        self._misreads = welded and int(mujoco.__version__.partition(".")[0]) < 4
        self._object = m.body(OBJECT).id
        free = m.joint(OBJECT)
        self._object_q = slice(free.qposadr[0], free.qposadr[0] + 7)
        self._object_dofs = slice(free.dofadr[0], free.dofadr[0] + 6)
        self._gripped_at = np.zeros((len(names), 3))
        self._fresh = False

    # -- state and inputs ----------------------------------------------------------------------------------------

    def reset(self, x: Array) -> None:
        """Put the joints to ``x`` (nv,), at rest."""
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._q_at] = x
        self._mujoco.mj_kinematics(self.model, self.data)
        self._fresh = False

    def grip(self, T_object_tool: tuple[pin.SE3, ...], *, where_they_are: bool) -> pin.SE3:
        """Place the object according to the first arm and close the grips. Returns the object's pose.

        The grip points are at ``T_object_tool``; with ``where_they_are`` they are at the tools.
        """
        m, real = self.model, list(T_object_tool)
        tools = [self._site(s) for s in self._tool_sites]
        O = tools[0] * real[0].inverse()
        if where_they_are:
            real = [O.actInv(T) for T in tools]
        self.data.qpos[self._object_q] = [*O.translation, *quaternion(O.rotation)]
        for k, (s, X) in enumerate(zip(self._grip_sites, real, strict=True)):
            m.site_pos[s], m.site_quat[s] = X.translation, quaternion(X.rotation)
            self._gripped_at[k] = X.translation
            m.site_sameframe[s] = self._mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # or MuJoCo may ignore the new place
        return O

    def grow(self, size: float) -> None:
        """Move the grip points with the object's size, a multiple of its first one."""
        self.model.site_pos[self._grip_sites] = size * self._gripped_at

    def open(self, k: int | None = None) -> None:
        """Open all welds, or that of arm k."""
        self.data.eq_active[self._welds if k is None else self._welds[k]] = 0
        self._fresh = False

    def attach(self, k: int) -> None:
        """Close the weld of arm k where its tool is: the grip point goes there first, so nothing is pulled."""
        self._refresh()
        site, X = self._grip_sites[k], self._tools_on_object()[k]
        self.model.site_pos[site], self.model.site_quat[site] = X.translation, quaternion(X.rotation)
        self._gripped_at[k] = X.translation
        self.data.eq_active[self._welds[k]] = 1
        self._fresh = False

    @property
    def welds(self) -> tuple[bool, ...]:
        """Which welds are closed (N,)."""
        return tuple(bool(active) for active in self.data.eq_active[self._welds])

    def drive(self, control: Array, applied: Array | None = None) -> None:
        """Inputs of the actuators (nv,), and torques beside them (nv,)."""
        self.data.ctrl[self._actuators] = control
        if applied is not None:
            self.data.qfrc_applied[self._v_at] = applied
        self._fresh = False

    def step(self, h: float) -> None:
        """One step of the engine of ``h`` seconds."""
        self.model.opt.timestep = h
        self._mujoco.mj_step(self.model, self.data)
        self._fresh = False

    # -- readings ------------------------------------------------------------------------------------------------

    @property
    def positions(self) -> Array:
        """Positions of the joints (nv,)."""
        return np.array(self.data.qpos[self._q_at])

    @property
    def velocities(self) -> Array:
        """Velocities of the joints (nv,)."""
        return np.array(self.data.qvel[self._v_at])

    @property
    def actuator_torques(self) -> Array:
        """Torques or forces of the actuators (nv,)."""
        self._refresh()
        return np.array(self.data.actuator_force[self._actuators])

    @property
    def joint_torques(self) -> Array:
        """Sum at the joints (nv,): actuators, torques beside them, compensation of gravity."""
        self._refresh()
        d = self.data
        return np.array((d.qfrc_actuator + d.qfrc_applied + d.qfrc_gravcomp)[self._v_at])

    @property
    def T_world_object(self) -> pin.SE3:
        """Pose of the object."""
        self._refresh()
        return placement(self.data.xpos[self._object], self.data.xmat[self._object])

    @property
    def T_world_tool(self) -> tuple[pin.SE3, ...]:
        """Placements of the tools."""
        self._refresh()
        return tuple(self._site(s) for s in self._tool_sites)

    @property
    def T_object_tool(self) -> list[pin.SE3]:
        """Placements of the tools on the object."""
        self._refresh()
        return self._tools_on_object()

    def weld_wrenches(self) -> Array:
        """Wrenches of the welds on the object (N, 6), at its origin and in its axes; zero for an open weld."""
        self._refresh()
        return self._at_welds()

    def sensed_wrenches(self, *, of_last_step: bool = False) -> Array:
        """Wrenches on the object by the sensors (N, 6), at the tools and in their axes.

        Before version 4 the engine's torque sensors misread welds under load; the torques of the welds then take their
        place. Readings ``of_last_step`` refer to its start, when its inputs began to act.
        """
        if not of_last_step:
            self._refresh()
        felt = np.array([self.data.sensordata[rows] for rows in self._sensors])
        if self._misreads:
            placed = zip(self._tools_on_object(), self._at_welds(), strict=True)
            felt[:, 3:] = [(X.action.T @ w)[3:] for X, w in placed]
        return felt

    # -- inside: as the engine left it ---------------------------------------------------------------------------

    def _at_welds(self) -> Array:
        m, d = self.model, self.data
        R = d.xmat[self._object].reshape(3, 3)
        ne = d.ne  # the rows of equalities come first
        J = d.efc_J.reshape(d.nefc, m.nv)[:ne, self._object_dofs]
        of_weld = d.efc_id[:ne] == self._welds[:, None]
        out: Array = (of_weld * d.efc_force[:ne]) @ J  # force in world axes, torque in body axes
        out[:, :3] = out[:, :3] @ R
        return out

    def _tools_on_object(self) -> list[pin.SE3]:
        O = placement(self.data.xpos[self._object], self.data.xmat[self._object])
        return [O.actInv(self._site(s)) for s in self._tool_sites]

    def _site(self, site: int) -> pin.SE3:
        return placement(self.data.site_xpos[site], self.data.site_xmat[site])

    def _refresh(self) -> None:
        """Evaluate the engine at the present state and command, without an effect on its next steps."""
        if self._fresh:
            return
        start = self.data.qacc_warmstart.copy()
        self._mujoco.mj_forward(self.model, self.data)
        self.data.qacc_warmstart[:] = start
        self._fresh = True
