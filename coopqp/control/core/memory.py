"""The memory of one compiled loop: three blocks of numbers, and views of their fields by name."""

from __future__ import annotations

import math
from typing import Any, final

import numpy as np

from coopqp.constraints.velocity import MOST_ROWS
from coopqp.control.lookahead.options import PlanLimits, PreviewOptions
from coopqp.control.monitoring.lag import grasp_levers, kept_samples
from coopqp.control.options import QPOptions
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.errors import ModelError
from coopqp.model.cell import RobotCell, of_cell
from coopqp.model.chain import Chain, moving_columns
from coopqp.model.links import joint_links
from coopqp.native import layout
from coopqp.native.constants import LARGEST_MOVE, MOST_JOINTS
from coopqp.spatial import Array


class NotForTheCore(Exception):  # noqa: N818
    """The cell has something that the core does not know; the plain loop runs it. No user sees it."""


@final
class Memory:
    """Blocks ``CONFIG``, ``STATE`` and ``WORK``; ``at[name]`` is the view of a field, ``gap`` numbers before the next.

    Attributes:
        sizes: symbols of the layout.
        places: where each field begins and ends in its block, in the layout's order.
    """

    def __init__(self, *, n: int, nv: int, nq: int, unknowns: int, past: int, gap: int = 0) -> None:
        self.sizes = layout.sizes(n=n, nv=nv, nq=nq, unknowns=unknowns, past=past, rows=MOST_ROWS)
        self.at: dict[str, Array] = {}
        self.places: list[tuple[int, int]] = []
        self.blocks: dict[str, Array] = {}
        for block, fields in layout.BLOCKS:
            places = layout.offsets(fields, self.sizes, gap=gap)
            memory = self.blocks[block] = np.zeros(max(end for _, end in places.values()) + gap)
            self.places += places.values()
            self.at.update({name: memory[begin:end] for name, (begin, end) in places.items()})
        #: Fields of structs, with their members as attributes; ``knots`` is a sequence of them.
        self.views: dict[str, Any] = layout.views(self.at)

    def of_rows(self) -> dict[str, Array]:
        """Inputs of further rows, and the places of the rows and of their quiet regions."""
        at, own = self.at, ("positions", "command", "quiet_centre", "quiet_reach")
        found = {name: at[name] for name in own} | {name: at[f"further_{name}"] for name in ("lower", "upper", "soft")}

        def number(field: str, member: str) -> Array:
            begin = layout.place(type(self.views[field]), member)
            return at[field][begin : begin + 1]

        return found | {
            "G": at["further"], "owner": at["further_owner"], "dt": number("proposal", "dt"),
            "quiet_slack": number("loop", "quiet_slack"), "quiet_approach": number("loop", "quiet_approach"),
            **{name: at[name] for name in ("quiet_ahead_centre", "quiet_ahead_reach", "knots")},
            **{name: at[name] for name in ("evading_positions", "evading_slope")},
            **{f"knot_{name}": at[f"knot_{name}"] for name in ("positions", "slope", "curvature")},
            "quiet_ahead_slack": number("loop", "quiet_ahead"), "quiet_ahead_approach": np.zeros(1),
            "knot_numbers": np.array([layout.SIZES["Knot"], layout.place(layout.Knot, "span")], dtype=float),
        }  # fmt: skip


def build_memory(
    chain: Chain,
    box: VelocityBox,
    shares: Array,
    unit: Array,
    at_grasps: Array,
    options: QPOptions,
    dt: float,
    *,
    gap: int,
) -> Memory:
    """The memory of a loop, its constants filled in.

    Raises:
        NotForTheCore: a joint type, or an order of joints, that the core does not know.
    """
    cell = chain.cell
    starts, counts = _arms(chain)
    memory = Memory(
        n=len(cell),
        nv=cell.nv,
        nq=cell.nq,
        unknowns=unit.size,
        past=kept_samples(options.supervision, dt),
        gap=gap,
    )
    at, limits = memory.at, cell.limits
    at["arm_start"][:], at["arm_size"][:] = starts, counts
    _put_links(chain, at)
    at["near_cos"][:] = 1.0  # of position 0
    at["continuous"][:], at["q_index"][:] = cell.continuous, cell.position_index
    at["scale"][:], at["shares"][:], at["unit"][:] = chain.scale, shares.ravel(), unit
    at["low"][:], at["high"][:] = limits.lower, limits.upper
    at["speed"][:], at["acceleration"][:] = limits.velocity, limits.acceleration
    at["most_move"][:] = np.where(box.unlimited, LARGEST_MOVE, np.inf)
    at["at_grasps"][:] = at_grasps.ravel()
    at["levers"][:] = grasp_levers(chain.grasp, at_grasps[5, 5]).ravel()
    stiffness = options.supervision.stiffness
    at["softness"][:] = 0.0 if stiffness is None else 1.0 / np.asarray(stiffness, dtype=float)
    posture = options.posture
    bounded = np.isfinite(limits.lower) & np.isfinite(limits.upper)
    at["posture_cap"][:] = posture.speed_share * np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    at["posture_bounded"][:] = bounded
    at["posture_middle"][bounded] = 0.5 * (limits.lower[bounded] + limits.upper[bounded])
    put_options(memory, chain, box, options, dt)
    return memory


def put_options(memory: Memory, chain: Chain, box: VelocityBox, options: QPOptions, dt: float) -> None:
    """Put the settings of a path into the memory; what belongs to the solver stays."""
    numbers = memory.views["options"]
    _put_plan(chain, memory.at, numbers, options, dt)
    _put_options(numbers, box, options, dt)


def _arms(chain: Chain) -> tuple[list[int], list[int]]:
    columns = chain.moving_columns
    if any(len(c) < 6 for c in columns):
        raise NotForTheCore("an arm has fewer than six joints")
    if any(len(c) > MOST_JOINTS for c in columns):
        raise NotForTheCore(f"an arm has more than {MOST_JOINTS} joints")
    if any((np.diff(c) != 1).any() for c in columns):
        raise NotForTheCore("the joints of an arm do not follow each other")
    return [int(c[0]) for c in columns], [len(c) for c in columns]


def _put_links(chain: Chain, at: dict[str, Array]) -> None:
    """Placement of each joint in the one before, of the object on each arm's last joint, and of the tool there."""
    cell = chain.cell
    at["link_R"][:], at["link_p"][:], at["prismatic"][:], aligned = _links_of(cell)
    object_R, object_p, tool_p = (at[name].reshape(len(cell), -1) for name in ("object_R", "object_p", "tool_p"))
    for k, turned in enumerate(aligned):
        Y = cell.T_joint_tool[k] * chain.grasp.T_object_tool[k].inverse()
        object_R[k], object_p[k] = (turned.T @ Y.rotation).ravel(), turned.T @ Y.translation
        tool_p[k] = turned.T @ cell.T_joint_tool[k].translation


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


def _put_plan(chain: Chain, at: dict[str, Array], numbers: Any, options: QPOptions, dt: float) -> None:
    plan = PlanLimits.of(chain.cell, options.preview or PreviewOptions(), dt=dt)
    at["plan_acceleration"][:] = plan.acceleration  # the way to a new target keeps to them without a preview, too
    if options.preview is None:
        return
    at["plan_speed"][:] = plan.speed
    at["plan_jump"][:], at["slope_change"][:] = plan.jump, plan.slope_change
    at["plan_room"][:] = plan.room
    numbers.slope_cap, numbers.room = plan.slope_cap, plan.room.max()


def _put_options(numbers: Any, box: VelocityBox, o: QPOptions, dt: float) -> None:
    s, p, w = o.supervision, o.preview, o.weights
    low, high = s.dt_range
    values: dict[str, float] = {
        "nominal_dt": dt, "grasp_gain": o.grasp_gain, "path_gain": o.path_gain,
        "correction_speed": o.correction_speed, "correction_spin": o.correction_spin,
        "measurement_time": o.measurement_time, "shortcut": o.shortcut, "accelerates": box.accelerates,
        "recovery_unit": w.recovery**-0.5, "relax_unit": w.clearance**-0.5, "blocked_rate": o.blocked_rate,
        "rein_slope": (p or PreviewOptions()).slope(accelerates=box.accelerates, dt=dt),
        "off_path_distance": o.off_path_distance, "off_path_angle": o.off_path_angle,
        "posture_gain": o.posture.gain, "centring": o.posture.centring, "manipulability": o.posture.manipulability,
        "slow_from": -1.0 if s.slow_from is None else s.slow_from, "hold_from": s.hold_from, "let_in": s.let_in,
        "noise_margin": s.noise_margin, "recovery_time": s.recovery_time, "fault_from": s.fault_from,
        "stall_samples": s.stall_samples or 0, "stall_share": s.stall_share, "silent_time": s.silent_time,
        "filter_time": s.filter_time, "dt_low": low, "dt_high": high, "joint_jump": s.joint_jump,
        "watches_force": s.stiffness is not None, "force_limit": s.force_limit, "servo_delay": s.servo_delay,
        "apart_hold": math.inf if s.apart_from is None else s.apart_from,
    }  # fmt: skip
    if p is not None:
        values |= {
            "rise": p.slope(accelerates=box.accelerates, dt=dt), "looks_ahead": 1.0, "caps_speed": box.accelerates,
            "cell": p.cell, "joint_step": p.joint_step,
            "slope_step": p.slope_step, "shortest": p.shortest, "curvature_share": p.curvature_share, "doubt": p.doubt,
            "singular_rate": p.singular_rate, "newton_steps": p.newton_steps,
        }  # fmt: skip
    for name, value in values.items():
        setattr(numbers, name, value)


def same_kinematics(chain: Chain, linearise: object, *, samples: int = 3, tolerance: float = 1e-9) -> bool:
    """Whether the core's kinematics are Pinocchio's, at seeded random configurations of this very robot."""
    rng, cell = np.random.default_rng(0), chain.cell
    carried, jacobian = np.zeros(12 * len(cell)), np.zeros(6 * cell.nv)
    moving = np.concatenate(chain.moving_columns)
    reach = 1.0
    for _ in range(samples):
        x = rng.uniform(-2.0, 2.0, cell.nv)
        q = cell.configuration(x)
        O = chain.carried(q)
        about = O[0].translation.copy()
        linearise(x, about, carried, jacobian)  # type: ignore[operator]
        chain.evaluate(q, about)
        mine = carried.reshape(-1, 12)
        rotations, origins = np.array([own.rotation for own in O]), np.array([own.translation for own in O])
        reach = max(reach, float(np.abs(origins).max()))
        away = np.abs(mine[:, :9].reshape(-1, 3, 3) - rotations).max()
        away = max(away, np.abs(mine[:, 9:] - origins).max() / reach)
        away = max(away, np.abs(jacobian.reshape(-1, 6)[moving] - np.hstack(chain.jacobians).T).max() / reach)
        if not away < tolerance:
            return False
    return True
