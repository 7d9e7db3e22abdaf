"""The core of one compiled loop, with views of the fields of its memory by name."""

from __future__ import annotations

import math
from typing import Any, final

import numpy as np

import coopqp.native._core as native
from coopqp.constraints.velocity import MOST_ROWS
from coopqp.control.lookahead.options import PlanLimits, PreviewOptions
from coopqp.control.monitoring.lag import grasp_levers, kept_samples
from coopqp.control.monitoring.supervision import grasp_lengths
from coopqp.control.options import QPOptions
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.errors import ModelError
from coopqp.model.cell import RobotCell, of_cell
from coopqp.model.chain import Chain, moving_columns
from coopqp.model.links import joint_links
from coopqp.native import layout
from coopqp.native.constants import (
    CALM,
    LARGEST_MOVE,
    MOST_GROUP_JOINTS,
    MOST_JOINTS,
    MOST_KNOTS,
    MOST_SHARED,
    MOST_SHARING,
)
from coopqp.spatial import Array


class NotForTheCore(Exception):  # noqa: N818
    """The cell has something that the core does not know; the plain loop runs it. No user sees it."""


@final
class Memory:
    """A core, and views of its memory: ``at[name]`` is a field, and ``options``, ``loop``, … are its structs.

    Args:
        chain: the arms and their grasp.
        unknowns: of the condensed QP without the slacks of recovery and relaxation.
        past: samples in which a stall is looked for.
        arithmetic: ``"plain"`` for instructions that every processor has.
    """

    def __init__(self, chain: Chain, *, unknowns: int, past: int, arithmetic: str = "auto") -> None:
        cell, plain = chain.cell, arithmetic == "plain"
        shared = _groups(chain)
        joints = (np.array(x, dtype=float) for x in (*_arms(chain), *shared, cell.position_index, cell.continuous))
        self.core: Any = native.Core(*joints, cell.nq, unknowns, past, MOST_ROWS, plain)
        self.at: dict[str, Array] = self.core.fields()
        self.options, self.loop, self.travels, self.proposal = (
            layout.STRUCTS[name.capitalize()].from_buffer(self.at[name])
            for name in ("options", "loop", "travels", "proposal")
        )
        self.knots = (layout.Knot * MOST_KNOTS).from_buffer(self.at["knots"])

    def of_rows(self) -> dict[str, Array]:
        """Inputs of further rows, and the places of the rows and of their quiet regions."""
        at, own = self.at, ("positions", "command", "quiet_centre", "quiet_reach")
        found = {name: at[name] for name in own} | {name: at[f"further_{name}"] for name in ("lower", "upper", "soft")}

        def number(struct: Any, member: str) -> Array:
            return np.frombuffer(struct, count=1, offset=getattr(type(struct), member).offset)

        return found | {
            "G": at["further"], "owner": at["further_owner"], "dt": number(self.proposal, "dt"),
            "quiet_slack": number(self.loop, "quiet_slack"), "quiet_approach": number(self.loop, "quiet_approach"),
            **{name: at[name] for name in ("quiet_ahead_centre", "quiet_ahead_reach", "knots")},
            **{name: at[name] for name in ("evading_positions", "evading_slope")},
            **{f"knot_{name}": at[f"knot_{name}"] for name in ("positions", "slope", "curvature")},
            "quiet_ahead_slack": number(self.loop, "quiet_ahead"), "quiet_ahead_approach": np.zeros(1),
            "knot_numbers": np.array([layout.SIZES["Knot"], layout.Knot.span.offset / 8]),
        }  # fmt: skip


def build_memory(
    chain: Chain, box: VelocityBox, shares: Array, unit: Array, options: QPOptions, dt: float, *, arithmetic: str
) -> Memory:
    """The core of a loop and its memory, the constants filled in.

    Raises:
        NotForTheCore: a joint type, or an order of joints, that the core does not know.
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
        for name in layout.members(numbers) & vars(source).keys():  # many have the core's names
            if isinstance(value := getattr(source, name), (int, float)):
                setattr(numbers, name, value)
    slope = (p or PreviewOptions()).slope(accelerates=box.accelerates, dt=dt)
    values: dict[str, float] = {
        "nominal_dt": dt, "accelerates": box.accelerates, "recovery_unit": w.recovery**-0.5,
        "relax_unit": w.clearance**-0.5, "part_unit": w.chain**-0.5,
        "calm_unit": max(w.posture, CALM * w.chain) ** -0.5,
        "rein_slope": slope, "posture_gain": o.posture.gain,
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


def _arms(chain: Chain) -> tuple[list[int], list[int]]:
    """First column and number of each arm's own joints."""
    if any(len(c) > MOST_JOINTS for c in chain.moving_columns):
        raise NotForTheCore(f"an arm has more than {MOST_JOINTS} joints")
    columns = [np.setdiff1d(c, chain.cell.shared) for c in chain.moving_columns]
    if any(len(c) == 0 for c in columns):
        raise NotForTheCore("an arm has no joints of its own")
    if any((np.diff(c) != 1).any() for c in columns):
        raise NotForTheCore("the joints of an arm do not follow each other")
    return [int(c[0]) for c in columns], [len(c) for c in columns]


def _groups(chain: Chain) -> tuple[Array, Array]:
    """The group of each arm (N,), and that of each joint that its arms share (nv,); −1 for none."""
    cell = chain.cell
    of_arm, of_joint = np.full(len(cell), -1.0), np.full(cell.nv, -1.0)
    for i, arms in enumerate(cell.groups):
        ways = [np.intersect1d(chain.moving_columns[k], cell.shared) for k in arms]
        if any(not np.array_equal(way, ways[0]) for way in ways):
            raise NotForTheCore("some of a robot's arms share joints that others of its arms do not have")
        joints = len(ways[0]) + sum(len(chain.moving_columns[k]) - len(ways[0]) for k in arms)
        if len(arms) > MOST_SHARING or len(ways[0]) > MOST_SHARED or joints > MOST_GROUP_JOINTS:
            raise NotForTheCore("too many arms, or joints of arms, share joints")
        of_arm[list(arms)], of_joint[ways[0]] = i, i
    return of_arm, of_joint


def _put_links(chain: Chain, at: dict[str, Array]) -> None:
    """Placement of each joint in the one before, of the object on each arm's last joint, and of the tool there."""
    cell = chain.cell
    at["link_R"][:], at["link_p"][:], at["prismatic"][:], aligned = _links_of(cell)
    held, tool_p = at["object"].reshape(len(cell), 12), at["tool_p"].reshape(len(cell), 3)
    for k, turned in enumerate(aligned):
        Y = cell.T_joint_tool[k] * chain.grasp.T_object_tool[k].inverse()
        held[k] = [*(turned.T @ Y.rotation).ravel(), *(turned.T @ Y.translation)]
        tool_p[k] = turned.T @ cell.T_joint_tool[k].translation
    at["places"][:] = at["object"]  # of the object without a shift


@of_cell
def _links_of(cell: RobotCell) -> tuple[Array, Array, Array, list[Array]]:
    """The numbers of all joints, each with its z axis along the joint's axis, and the last rotation of each arm."""
    R, p, slides, aligned = np.tile(np.eye(3), (cell.nv, 1, 1)), np.zeros((cell.nv, 3)), np.zeros(cell.nv), []
    for k, columns in enumerate(moving_columns(cell)):
        joints = [int(j) + 1 for j in columns]
        if any(cell.model.joints[j].idx_v != j - 1 for j in joints):
            raise NotForTheCore(f"the joints of arm {cell.arm_names[k]} are in another order")
        if cell.tool_joints[k] != joints[-1]:
            raise NotForTheCore(f"the tool of arm {cell.arm_names[k]} is not on its last joint")
        try:
            R[columns], p[columns], slides[columns], turned = joint_links(cell.model, joints)
        except ModelError as error:
            raise NotForTheCore(str(error)) from error
        aligned.append(turned)
    return R.ravel(), p.ravel(), slides, aligned


def same_kinematics(chain: Chain, linearise: object, *, samples: int = 3, tolerance: float = 1e-9) -> bool:
    """Whether the core's kinematics are Pinocchio's, at seeded random configurations of this very robot."""
    rng, cell = np.random.default_rng(0), chain.cell
    carried, jacobian = np.zeros((len(cell), 12)), np.zeros((cell.nv, 6))
    moving = np.concatenate(chain.moving_columns)
    for x in rng.uniform(-2.0, 2.0, (samples, cell.nv)):
        q = cell.configuration(x)
        O = chain.carried(q)
        about = O[0].translation.copy()
        linearise(x, about, carried, jacobian)  # type: ignore[operator]
        chain.evaluate(q, about)
        expected = np.array([[*own.rotation.ravel(), *own.translation] for own in O])
        reach = max(1.0, float(np.abs(expected[:, 9:]).max()))
        units = np.repeat((1.0, reach), (9, 3))  # of rotations, and of origins
        away = np.abs((carried - expected) / units).max()
        if not max(away, np.abs(jacobian[moving] - np.hstack(chain.jacobians).T).max() / reach) < tolerance:
            return False
    return True
