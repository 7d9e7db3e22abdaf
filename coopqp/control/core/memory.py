"""The core of one loop, with views of the fields of its memory by name."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from coopqp.constraints.velocity import MOST_ROWS
from coopqp.control.lookahead.options import PlanLimits, PreviewOptions
from coopqp.control.monitoring.options import SupervisionOptions
from coopqp.control.options import QPOptions
from coopqp.control.step.other_solver import CALM
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.core import _core
from coopqp.core._core import (
    LAG,
    LARGEST_MOVE,
    MOST_GROUP_JOINTS,
    MOST_SHARING,
)
from coopqp.errors import ModelError
from coopqp.model.cell import RobotCell, of_cell
from coopqp.model.chain import Chain, moving_columns
from coopqp.model.grasp import Grasp
from coopqp.model.links import check_count, joint_links
from coopqp.spatial import Array, skew

#: Least distance between a grasp and the grasps' centre that counts [m].
_LEAST_REACH = 0.1
#: A late arm is looked for in this many samples before the last ones, at most.
_MOST_LATE = 200


@final
class Memory:
    """A core, and views of its memory: ``at[name]`` is a field, and ``options``, ``loop``, … are its structs.

    Args:
        chain: the arms and their grasp.
        unknowns: of the condensed QP without the slacks of recovery and relaxation.
        past: samples in which a stall is looked for.
        arithmetic: ``"plain"`` for instructions that every processor has.

    Raises:
        ModelError: too many joints, or too many arms that share some.
    """

    def __init__(self, chain: Chain, *, unknowns: int, past: int, arithmetic: str = "auto") -> None:
        cell, plain = chain.cell, arithmetic == "plain"
        _check_sizes(cell)
        moves, groups = np.zeros((len(cell), cell.nv)), np.full(len(cell), -1.0)
        for k, columns in enumerate(chain.moving_columns):
            moves[k, columns] = 1.0
        for i, arms in enumerate(cell.groups):
            groups[list(arms)] = i
        joints = (np.array(x, dtype=float) for x in (moves.ravel(), groups, cell.position_index, cell.continuous))
        core = self.core = _core.Core(*joints, cell.nq, unknowns, past, MOST_ROWS, plain)
        self.at: dict[str, Array] = core.fields()
        self.options, self.loop, self.travels, self.proposal = core.options, core.loop, core.travels, core.proposal

    def of_rows(self) -> dict[str, Array]:
        """Inputs of further rows, and the places of the rows and of their quiet regions."""
        renamed = {name: self.at[f"further_{name}"] for name in ("lower", "upper", "soft", "owner")}
        return self.at | renamed | {"G": self.at["further"], "quiet_ahead_approach": np.zeros(1)}


def build_memory(
    chain: Chain, box: VelocityBox, shares: Array, unit: Array, options: QPOptions, dt: float, *, arithmetic: str
) -> Memory:
    """The core of a loop and its memory, the constants filled in.

    Raises:
        ModelError: too many joints, or too many arms that share some; or a joint that moves as no known kind does.
    """
    cell, past = chain.cell, kept_samples(options.supervision, dt)
    memory = Memory(chain, unknowns=unit.size, past=past, arithmetic=arithmetic)
    at, limits = memory.at, cell.limits
    _put_links(chain, at)
    at["near_cos"][:] = 1.0  # of position 0
    stiffness, posture = options.supervision.stiffness, options.posture
    at_grasps = grasp_lengths(chain.grasp)
    bounded = np.isfinite(limits.lower) & np.isfinite(limits.upper)
    fields = {
        "scale": chain.scale, "shares": shares.ravel(), "holding": np.ones(len(cell)), "unit": unit,
        "low": limits.lower, "high": limits.upper, "speed": limits.velocity, "acceleration": limits.acceleration,
        "most_move": np.where(box.unlimited, LARGEST_MOVE, np.inf), "at_grasps": at_grasps.ravel(),
        "levers": grasp_levers(chain.grasp, at_grasps[5, 5]).ravel(),
        "softness": 0.0 if stiffness is None else 1.0 / np.asarray(stiffness, dtype=float),
        "posture_cap": posture.speed_share * np.where(np.isfinite(limits.velocity), limits.velocity, 1.0),
        "posture_bounded": bounded,
        "posture_middle": np.where(bounded, (limits.lower, limits.upper), 0.0).mean(axis=0),
    }  # fmt: skip
    for name, value in fields.items():
        at[name][:] = value
    put_options(memory, chain, box, options, dt)
    return memory


def put_options(memory: Memory, chain: Chain, box: VelocityBox, o: QPOptions, dt: float) -> None:
    """Put the settings of a path into the memory; what belongs to the solver stays."""
    at, numbers, s, p, w = memory.at, memory.options, o.supervision, o.preview, o.weights
    plan = PlanLimits.of(chain.cell, p or PreviewOptions(), dt=dt)
    at["plan_acceleration"][:] = plan.acceleration  # the way to a new target keeps to them without a preview, too
    for source in (o, o.posture, s) if p is None else (o, o.posture, s, p):
        for name, value in vars(source).items():  # many have the core's names
            if isinstance(value, (int, float)) and hasattr(numbers, name):
                setattr(numbers, name, value)
    slope = (p or PreviewOptions()).slope(accelerates=box.accelerates, dt=dt)
    values: dict[str, float] = {
        "nominal_dt": dt, "accelerates": box.accelerates, "recovery_unit": w.recovery**-0.5,
        "relax_unit": w.clearance**-0.5, "part_unit": w.chain**-0.5,
        "calm_unit": max(w.posture, CALM * w.chain) ** -0.5,
        "override_slope": slope, "drift_limit": s.let_in, "posture_gain": o.posture.gain,
        "slow_from": -1.0 if s.slow_from is None else s.slow_from, "stall_samples": s.stall_samples or 0,
        "dt_low": s.dt_range[0], "dt_high": s.dt_range[1], "watches_force": s.stiffness is not None,
        "apart_hold": math.inf if s.apart_from is None else s.apart_from,
    }  # fmt: skip
    if p is not None:
        for name in ("speed", "jump", "room"):
            at[f"plan_{name}"][:] = getattr(plan, name)
        at["slope_change"][:] = plan.slope_change
        values |= {"slope_cap": plan.slope_cap, "room": plan.room.max()}
        values |= {"rise": slope, "looks_ahead": 1.0, "caps_speed": box.accelerates}
    for name, value in values.items():
        setattr(numbers, name, value)


def _check_sizes(cell: RobotCell) -> None:
    """Raise where an arm has more joints, or arms that share some are more, than the core has room for."""
    for arm, columns in zip(cell.arms, moving_columns(cell), strict=True):
        check_count(arm.name, len(columns))
    for arms in cell.groups:
        joints = len(np.unique(np.concatenate([moving_columns(cell)[k] for k in arms])))
        if len(arms) > MOST_SHARING or joints > MOST_GROUP_JOINTS:
            raise ModelError(
                f"robot '{cell.arms[arms[0]].robot}': {len(arms)} arms with {joints} joints share some of them; the "
                f"controller takes up to {MOST_SHARING} such arms and {MOST_GROUP_JOINTS} joints. Give fewer arms, or "
                "lock what they share: locked_joints."
            )


def _put_links(chain: Chain, at: dict[str, Array]) -> None:
    """Placement of each joint in the one before, of the object on each arm's last joint, and of the tool there."""
    cell = chain.cell
    at["link_R"][:], at["link_p"][:], at["pitch"][:], aligned = _links_of(cell)
    held, tool_p = at["object"].reshape(len(cell), 12), at["tool_p"].reshape(len(cell), 3)
    for k, turned in enumerate(aligned):
        Y = cell.T_joint_tool[k] * chain.grasp.T_object_tool[k].inverse()
        held[k] = [*(turned.T @ Y.rotation).ravel(), *(turned.T @ Y.translation)]
        tool_p[k] = turned.T @ cell.T_joint_tool[k].translation
    at["places"][:] = at["object"]  # of the object without a shift


@of_cell
def _links_of(cell: RobotCell) -> tuple[Array, Array, Array, list[Array]]:
    """The numbers of all joints, each with its z axis along the joint's axis, and the last rotation of each arm."""
    R, p, pitch, aligned = np.tile(np.eye(3), (cell.nv, 1, 1)), np.zeros((cell.nv, 3)), np.zeros(cell.nv), []
    for arm, columns in zip(cell.arms, moving_columns(cell), strict=True):
        try:
            R[columns], p[columns], pitch[columns], turned = joint_links(cell.model, [int(j) + 1 for j in columns])
        except ModelError as error:
            raise ModelError(f"arm '{arm.name}': {error}") from error
        aligned.append(turned)
    return R.ravel(), p.ravel(), pitch, aligned


def check_kinematics(chain: Chain, linearise: object, *, samples: int = 3, tolerance: float = 1e-9) -> None:
    """Compare the core's kinematics with Pinocchio's, at seeded random configurations of this very robot.

    Raises:
        ModelError: those of an arm differ.
    """
    rng, cell = np.random.default_rng(0), chain.cell
    carried, jacobian = np.zeros((len(cell), 12)), np.zeros((cell.nv, 6))
    for x in rng.uniform(-2.0, 2.0, (samples, cell.nv)):
        q = cell.configuration(x)
        O = chain.carried(q)
        about = O[0].translation.copy()
        linearise(x, about, carried, jacobian)  # type: ignore[operator]
        chain.evaluate(q, about)
        expected = np.array([[*own.rotation.ravel(), *own.translation] for own in O])
        reach = max(1.0, float(np.abs(expected[:, 9:]).max()))
        units = np.repeat((1.0, reach), (9, 3))  # of rotations, and of origins
        away = np.abs((carried - expected) / units).max(axis=1)
        for name, own, J, columns in zip(cell.arm_names, away, chain.jacobians, chain.moving_columns, strict=True):
            if not max(own, np.abs(jacobian[columns] - J.T).max() / reach) < tolerance:
                raise ModelError(
                    f"arm '{name}': its joints do not move it as Pinocchio says, at random configurations. Build its "
                    "model of joints that turn, slide, or screw about one axis."
                )


def grasp_lengths(grasp: Grasp) -> Array:
    """Lᵀ (6, 6): ``d @ Lᵀ`` are the lengths at the grasps [m] of displacements d (…, 6) of the object [m, rad].

    The first three are the displacement of the grasps' centre, the others the turn times the largest distance of a
    grasp from it: if one arm turns the object, the grasps part by this length.
    """
    points = np.array([X.translation for X in grasp.T_object_tool])
    centre = points.mean(axis=0)
    reach = max(float(np.linalg.norm(points - centre, axis=1).max()), _LEAST_REACH)
    L = np.eye(6)
    L[:3, 3:] = -skew(centre)
    L[3:, 3:] *= reach
    return L.T


def kept_samples(options: SupervisionOptions, dt: float) -> int:
    """Number of samples in which a stall is looked for, of length ``dt`` [s]: those of a lag beside stall_samples."""
    return 1 + (options.stall_samples or 1) + math.ceil(min(LAG / dt, _MOST_LATE) - 1e-9)


def grasp_levers(grasp: Grasp, reach: float) -> Array:
    """Places of the grasps from their centre, over a reach (N, 3)."""
    points = np.array([X.translation for X in grasp.T_object_tool])
    out: Array = (points - points.mean(axis=0)) / reach
    return out
