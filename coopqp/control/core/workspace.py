"""The memory of one fused step: what goes in, what comes out, and live views of Pinocchio's results.

Both kernels (NumPy and compiled) read and write these arrays and nothing else, so one can stand for the other.
"""

from __future__ import annotations

import enum
from typing import Protocol

import numpy as np
import pinocchio as pin

from coopqp.control.forms import CondensedQp
from coopqp.control.limits import VelocityBox
from coopqp.model.chain import Chain
from coopqp.spatial import Array


class Outcome(enum.IntEnum):
    """What a kernel found."""

    NOMINAL = 0  #: the nominal command is admissible
    RAY = 1  #: a lower rate on the path is; ``rate``, ``joint`` and ``side`` say which and why
    OPEN = 2  #: neither, or something unusual (a joint outside its limits, a singular arm): the QP's business


class Workspace:
    """Arrays of one controller, allocated once.

    Inputs: ``R`` (3, 3), ``p`` (3,) and ``action`` Ad(R) (6, 6) of the reference pose (:meth:`set_pose`) and ``along``
    ν (6,), or ``line`` (21,) where ``ON_LINE`` is set; ``scalars`` (see the index constants), and where they apply
    ``measured`` (6,), ``null_along``, ``null_offset`` (nv,).
    State, which a settled step leaves as the next one needs it, and an open one as it was: ``positions`` and
    ``v_prev`` (nv,), ``predicted`` (N, 6), the errors foreseen for the step, and the scalars ``HAS_PREDICTED`` and
    ``LAST_DT``.
    Outputs: ``velocity`` (nv,), ``midpoint``, the positions half a step after the step's end at the predicted velocity
    (nv,), ``errors`` (N, 6), ``along_velocity``, the joints' share of ``along`` (nv,) (the NumPy kernel fills it at
    need or where ``wants_along``), and ``result`` [rate, joint, side, square of the path correction].
    :meth:`StepKernel.observe` puts out ``common`` (6,), the object's error, besides ``errors``.
    The rest is a kernel's own: ``grasp``, ``offsets``, ``path``, and the box's ``lower`` and ``upper``.

    ``rows`` of a kernel fills ``qp``, the condensed QP whose unknowns are in the units ``unit``, but for the bounds of
    x, and lists the joints ``outside`` their limits, with the velocities ``recovery`` (nv,) that lead them back.

    What the NumPy kernel multiplies by one matrix lies together: ``posed`` holds ``action``, R, p and ν, ``twists``
    (2 + 2N, 6) the rows ν, c_p, errors, predicted, ``motion`` (5, nv) the rows velocity, v_prev, positions, and two of
    the kernel's own, and ``ahead`` (6, nv) five of the kernel's own, midpoint.
    """

    # indices of scalars
    DT, GRASP_GAIN, PATH_GAIN, SPEED, SPIN, HAS_MEASURED, HAS_PREDICTED, LAST_DT, ON_LINE = range(9)
    # indices of result
    RATE, JOINT, SIDE, CORRECTION = range(4)

    def __init__(self, chain: Chain, shares: Array, box: VelocityBox, *, wants_along: bool = False) -> None:
        n, nv = chain.n_arms, chain.nv
        self.chain, self.box, self.wants_along = chain, box, wants_along
        self.n_arms, self.nv = n, nv
        self.placements, self.jacobian_T = chain.live_views()
        self.Y_transposed, self.tool_joints = chain.Y_transposed, chain.tool_joints
        self.starts = np.array([columns[0] for columns in chain.moving_columns], dtype=np.int64)
        self.sizes = np.array([len(columns) for columns in chain.moving_columns], dtype=np.int64)
        self.scale = chain.scale
        self.shares = np.ascontiguousarray(shares)
        limits = box.limits
        self.low, self.high = limits.lower, limits.upper
        self.speed, self.acceleration = limits.velocity, limits.acceleration
        self.per_acceleration = 0.5 / limits.acceleration  # braking from v takes v² times it; 0 without limit
        self.lower, self.upper = box.lower, box.upper
        memory = np.zeros(60 + 12 * n)
        self.posed, self.twists = memory[:54], memory[48:].reshape(2 + 2 * n, 6)
        self.action, self.R, self.p = memory[:36].reshape(6, 6), memory[36:45].reshape(3, 3), memory[45:48]
        self.along, self.path = self.twists[:2]
        self.errors, self.predicted = self.twists[2 : 2 + n], self.twists[2 + n :]
        self.set_pose(pin.SE3.Identity())
        self.motion = np.zeros((5, nv))
        self.velocity, self.v_prev, self.positions = self.motion[:3]
        self.measured = np.zeros(6)
        self.null_along, self.null_offset = np.zeros(nv), np.zeros(nv)
        self.scalars, self.result, self.line = np.zeros(9), np.zeros(4), np.zeros(21)
        self.grasp, self.offsets = np.zeros((n, 6)), np.zeros((n, 6))
        self.common = np.zeros(6)
        self.along_velocity, self.ahead = np.zeros(nv), np.zeros((6, nv))
        self.midpoint = self.ahead[5]
        self.qp = CondensedQp(nv, 9 + chain.redundancy)
        self.base, self.columns, self.norms = self.qp.base, self.qp.columns, self.qp.norms
        self.rows, self.row_lower, self.row_upper = self.qp.problem.C, self.qp.problem.l, self.qp.problem.u
        self.unit = np.ones(9 + chain.redundancy)
        self.recovery, self.outside = np.zeros(nv), np.zeros(nv, dtype=np.int64)
        self.redundant = bool((self.sizes > 6).any())
        gapless = all(np.all(np.diff(columns) == 1) for columns in chain.moving_columns)
        self.eligible = bool((self.sizes >= 6).all()) and gapless

    def set_pose(self, pose: pin.SE3) -> None:
        """The reference pose."""
        self.action[:] = pose.action
        self.R[:] = pose.rotation
        self.p[:] = pose.translation


class StepKernel(Protocol):
    """One fused step over a workspace whose Pinocchio data are up to date."""

    name: str
    #: The kernel evaluates the reference pose and ``along`` itself where ``ON_LINE`` is set.
    follows_lines: bool

    def __init__(self, workspace: Workspace) -> None: ...

    def step(self, cap: float, clock: float, span: float) -> int:
        """Errors, corrections, nominal command, limits and, on a miss, the ray; returns an :class:`Outcome`.

        Args:
            cap: largest rate, that of the nominal command.
            clock, span: on a line, the reference pose's clock, and ``along`` is the mean twist over ``span`` from there
                [s], or the twist at ``clock`` where ``span`` is negative.
        """
        ...

    def observe(self, clock: float) -> bool:
        """``errors`` and ``common`` at the placements; False if that is the step's business after all."""
        ...

    def rows(self, cap: float, clock: float, span: float) -> int:
        """The condensed QP of the step that was left open, from the same arguments.

        Fills ``qp``, errors and corrections, and returns the number of joints outside their limits; −1 where an arm is
        near a singularity, or something is not finite.
        """
        ...
