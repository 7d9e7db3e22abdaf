"""The robot cell: several arms in one Pinocchio model.

The model of each arm is copied and placed at the arm's base. The names of its joints and frames get the arm's name as a
prefix (``master/joint_1``). Joints that several arms of one robot share are there once, with the robot's name as prefix
(``tiago/torso_lift_joint``), before the joints of the robot's first arm.
"""

from __future__ import annotations

import functools
import itertools
import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.checks import ArrayLike, as_tuple, as_vector, require
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.arm import Arm
from coopqp.model.joint_limits import LIMIT_FIELDS, JointLimits
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.robot import Robot
from coopqp.model.same_joints import without_copies
from coopqp.model.shared_joints import assemble_shared
from coopqp.shown import Shown
from coopqp.spatial import Array

__all__ = ["Arm", "JointLimits", "Robot", "RobotCell"]


#: Most joints that a sentence names.
_NAMED = 3
#: Norms of (cos, sin) this close to 1 are 1 but for rounding.
_UNIT = 4.0 * np.finfo(float).eps


class RobotCell(Shown):
    """N arms in one Pinocchio model.

    Attributes:
        model: Pinocchio model of all arms, with the joints in the order of the arms. Do not modify it.
        arms: the arms, as given, but for :attr:`locked`.
        arm_names: names of the arms.
        locked: names ``arm/joint`` of joints that were locked where they stand: they do not move the tool of their
            arm, and are joints of another arm, too, as where a robot with two arms is given twice.
        nq, nv: sizes of a configuration and of a velocity of the whole cell.
        q_slices, v_slices: slice of each arm's own joints in a configuration and in a velocity.
        columns: per arm, the velocity coordinates of all joints of its model (n,): its own, and those that it shares.
        shared: velocity coordinates of the joints that several arms share (S,): each is there once, before the own
            joints of its robot's first arm.
        groups: arms that share joints, the indices of each group; empty without shared joints.
        joint_names: name ``arm/joint`` of each velocity coordinate, ``robot/joint`` of one that arms share.
        limits: joint limits of the whole cell, shape (nv,) each.
        tool_joints, tool_frames: indices of the joint that carries each tool and of each tool frame.
        T_joint_tool: placement of each tool in the frame of its joint.
        position_index: index in a configuration of the position of each velocity coordinate (nv,). A continuous joint
            is stored as (cos, sin); the index is the cosine's.
        continuous: True for velocity coordinates of continuous joints (nv,).
        euclidean: True if no joint is continuous; a displacement is then simply added to a configuration.

    Raises:
        InvalidInputError: no arm, two arms with the same name, or a joint that moves the tools of two arms that are not
            of one :class:`Robot`: joints of the same name and kind at the same place in the world are one joint, which
            cannot follow two commands.
    """

    def __init__(self, arms: Iterable[Arm | Robot]) -> None:
        given = as_tuple(arms, "RobotCell", "Give a list of Arm.")
        if not given:
            raise InvalidInputError("a cell needs at least one arm", "RobotCell", "Give a list of Arm.")
        self.arms: tuple[Arm, ...] = tuple(x for y in given for x in (y.arms if isinstance(y, Robot) else (y,)))
        for arm in self.arms:
            require(arm, Arm, "RobotCell", "Give a list of Arm, built with Arm.from_urdf, or of Robot.")
        self.arm_names = tuple(arm.name for arm in self.arms)
        double = sorted({n for n in self.arm_names if self.arm_names.count(n) > 1})
        if double:
            raise InvalidInputError(f"two arms are named '{double[0]}'", "RobotCell", "Give each arm its own name.")

        self.arms, self.locked = without_copies(self.arms)
        self.groups = _groups(self.arms)
        clash = sorted({self.arms[group[0]].robot for group in self.groups} & set(self.arm_names))
        if clash:
            raise InvalidInputError(f"an arm and a robot are named '{clash[0]}'", "RobotCell", "Rename one of them.")
        self.model = _assemble(self.arms)[0]
        self.nq, self.nv = int(self.model.nq), int(self.model.nv)
        self.joint_names = tuple(name for name in self.model.names if name != "universe")
        if self.groups:
            self.columns = tuple(_columns(self.model, arm) for arm in self.arms)
            self.shared = np.array([j for j, n in enumerate(self.joint_names) if not self._owner(n)], dtype=np.intp)
            self.q_slices, self.v_slices = self._own_slices()
        else:
            self.q_slices, self.v_slices = _slices(self.arms, "nq"), _slices(self.arms, "nv")
            self.columns = tuple(np.arange(own.start, own.stop) for own in self.v_slices)
            self.shared = np.zeros(0, dtype=np.intp)
        self.limits = _limits(self.arms, self.columns, self.nv)
        frames = [self.model.getFrameId(f"{a.name}/{a.tool_frame}") for a in self.arms]
        self.tool_frames = tuple(int(f) for f in frames)
        self.tool_joints = tuple(int(self.model.frames[f].parentJoint) for f in frames)
        self.T_joint_tool = tuple(self.model.frames[f].placement.copy() for f in frames)
        joints = list(self.model.joints)[1:]  # joint 0 is the universe
        self.position_index = np.array([j.idx_q for j in joints])
        self.continuous = np.array([j.nq != j.nv for j in joints])
        self.euclidean = not self.continuous.any()
        turning = np.flatnonzero(self.continuous)
        self._turning = list(zip(turning.tolist(), self.position_index[turning].tolist(), strict=True))

    def __len__(self) -> int:
        return len(self.arms)

    def __repr__(self) -> str:
        parts = ", ".join(f"{a.name}: {a.model.nv} joints" for a in self.arms)
        return f"RobotCell({parts})"

    def standing_note(self) -> str:
        """A sentence on the joints that move no tool; empty without such joints."""
        moving = {j for tool in self.tool_joints for j in self.model.supports[tool]}
        names = [*self.locked, *(name for j, name in enumerate(self.model.names) if j and j not in moving)]
        if not names:
            return ""
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        one = len(names) == 1
        said = "moves no tool of its arm: it is" if one else "move no tool of their arm: they are"
        return f"{', '.join(names[:_NAMED])}{more} {said} locked where {'it stands' if one else 'they stand'}."

    def speed_note(self) -> str:
        """A sentence on the joints without a speed limit, which nothing slows down; empty without such joints."""
        free = np.flatnonzero(~np.isfinite(self.limits.velocity))
        if not len(free):
            return ""
        names = [self.joint_names[j] for j in free[:_NAMED]]
        more = f" and {len(free) - _NAMED} more" if len(free) > _NAMED else ""
        have, them = ("has", "it") if len(free) == 1 else ("have", "them")
        return f"{', '.join(names)}{more} {have} no speed limit: nothing slows the motion down for {them}."

    def notes(self) -> list[str]:
        """What to know of the joints before they move: :meth:`standing_note` and :meth:`speed_note`, none empty."""
        return [note for note in (self.standing_note(), self.speed_note()) if note]

    def index(self, arm: str | int) -> int:
        """Index of an arm, from its name or index."""
        if isinstance(arm, str):
            if arm not in self.arm_names:
                raise UnknownNameError("arm", arm, self.arm_names, "the cell")
            return self.arm_names.index(arm)
        if not 0 <= arm < len(self.arms):
            raise UnknownNameError("arm", str(arm), (str(i) for i in range(len(self.arms))), "the cell")
        return arm

    def joint_limit(self, j: int, kind: LimitKind) -> BindingLimit:
        """The limit of the joint of velocity coordinate ``j``, by name."""
        arm, _, joint = self.joint_names[j].partition("/")
        return BindingLimit(arm, joint, kind)

    def arm_of_joint(self, j: int) -> int:
        """Index of the arm of velocity coordinate ``j``; of a joint that arms share, of the first of them."""
        return next(k for k, own in enumerate(self.columns) if j in own)

    @property
    def bases(self) -> tuple[tuple[int, ...], ...]:
        """The indices of the arms that stand on each base: those of a robot, or one arm."""
        standing: dict[str, list[int]] = {}
        for k, arm in enumerate(self.arms):
            standing.setdefault(f"robot {arm.robot}" if arm.robot else f"arm {arm.name}", []).append(k)
        return tuple(tuple(arms) for arms in standing.values())

    @property
    def blocks(self) -> dict[str, slice]:
        """The velocity coordinates of each arm's own joints, and by a robot's name of those that its arms share."""
        own = dict(zip(self.arm_names, self.v_slices, strict=True))
        if not self.groups:
            return own
        first = {self.arms[group[0]].robot: group[0] for group in self.groups}
        out: dict[str, slice] = {}
        for k, name in enumerate(self.arm_names):
            robot = self.arms[k].robot
            if first.get(robot) == k:
                shared = [j for j in self.shared if self.joint_names[j].startswith(f"{robot}/")]
                out[robot] = slice(int(shared[0]), int(shared[-1]) + 1)
            out[name] = own[name]
        return out

    def refuse_shared(self, where: str) -> None:
        """Raise where joints that arms share are not known.

        Raises:
            InvalidInputError: arms of this cell share joints.
        """
        if self.groups:
            group = self.groups[0]
            arms = " and ".join(f"'{self.arm_names[k]}'" for k in group)
            joints = ", ".join(f"'{name}'" for name in self.arms[group[0]].shared)
            raise InvalidInputError(
                f"arms {arms} share {joints}, and joints that arms share are not known here yet",
                where,
                "Lock them where they are to stand: locked_joints of the robot.",
            )

    def _owner(self, joint_name: str) -> bool:
        return joint_name.partition("/")[0] in self.arm_names

    def _own_slices(self) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
        """Slices of the own joints of arms, which follow each other: in a configuration, and in a velocity."""
        joints = list(self.model.joints)[1:]
        q_slices, v_slices = [], []
        for columns in self.columns:
            own = np.setdiff1d(columns, self.shared)
            first, last = joints[own[0]], joints[own[-1]]
            q_slices.append(slice(first.idx_q, last.idx_q + last.nq))
            v_slices.append(slice(int(own[0]), int(own[-1]) + 1))
        return tuple(q_slices), tuple(v_slices)

    def with_limits(self, **changes: ArrayLike) -> RobotCell:
        """Return a copy with other limits (keywords of :class:`JointLimits`; a scalar or shape (nv,))."""
        limits = self.limits.replace(**changes)
        return RobotCell(
            replace(arm, limits=JointLimits(*(getattr(limits, f)[own] for f in LIMIT_FIELDS)))
            for arm, own in zip(self.arms, self.columns, strict=True)
        )

    def moved(self, q: Array, displacement: Array) -> Array:
        """Configuration (nq,) after a joint displacement (nv,) [rad or m]."""
        if self.euclidean:
            return q + displacement
        return np.asarray(pin.integrate(self.model, q, displacement))

    def check_configuration(self, q: ArrayLike, where: str) -> Array:
        """Return ``q`` as a new finite array (nq,), with the (cos, sin) of continuous joints normalised.

        What is normalised comes back with the same bits.

        Raises:
            InvalidInputError: wrong shape, NaN or infinite entries, or the norm of a (cos, sin) is off 1 by more
                than 1e-6.
        """
        vector = as_vector(q, self.nq, where)
        for j, i in self._turning:
            radius = float(np.hypot(vector[i], vector[i + 1]))
            if abs(radius - 1.0) > 1e-6:
                raise InvalidInputError(
                    f"continuous joint {self.joint_names[j]} is given by (cos, sin) at entries {i}, {i + 1}; "
                    f"their norm is {radius:.6g}",
                    where,
                    "Use coopqp.RobotCell.configuration to build a configuration from angles.",
                )
            if abs(radius - 1.0) > _UNIT:  # else the same bits: a command goes back in unchanged
                vector[i : i + 2] /= radius
        return vector

    def configuration(self, angles: ArrayLike) -> Array:
        """Configuration (nq,) from one position per joint (nv,) [rad or m]; continuous joints become (cos, sin)."""
        return self.configuration_of(as_vector(angles, self.nv, "RobotCell.configuration"))

    def configuration_of(self, x: Array) -> Array:
        """:meth:`configuration` of positions (nv,) that need no check."""
        q = np.empty(self.nq)
        q[self.position_index] = x
        if not self.euclidean:
            at = self.position_index[self.continuous]
            q[at], q[at + 1] = np.cos(x[self.continuous]), np.sin(x[self.continuous])
        return q

    def positions(self, q: Array) -> Array:
        """Joint positions (…, nv) [rad or m] of configurations (…, nq); continuous joints in (−π, π]."""
        if self.euclidean:
            return q.copy()
        x: Array = q.take(self.position_index, axis=-1)
        for j, i in self._turning:
            x[..., j] = np.arctan2(q[..., i + 1], q[..., i])
        return x

    def average(self, configurations: Iterable[ArrayLike]) -> Array:
        """Mean (nq,) of configurations (T, nq) measured at rest. The mean has less noise: use it as a start.

        Raises:
            InvalidInputError: no configuration, or an invalid one.
        """
        rows = [self.check_configuration(q, "RobotCell.average") for q in configurations]
        if not rows:
            raise InvalidInputError("no configurations", "RobotCell.average", "Measure at least once.")
        away = np.mean([pin.difference(self.model, rows[0], q) for q in rows], axis=0)
        return np.asarray(pin.integrate(self.model, rows[0], away))

    def at_rest(self, q: ArrayLike, where: str) -> Array:
        """One configuration (nq,) as :meth:`check_configuration`, or the mean of rows (n, nq) measured at rest, n ≥ 2.

        Raises:
            InvalidInputError: no configuration, or an invalid one.
        """
        try:
            rows = np.ndim(q) == 2 and np.shape(q)[0] > 1
        except ValueError:  # rows of several lengths
            rows = False
        return self.average(np.asarray(q)) if rows else self.check_configuration(q, where)

    def visual_model(self) -> pin.GeometryModel:
        """Visual shapes of all arms, for :attr:`model`; an arm without shapes adds none."""
        return _assemble(self.arms, "visual")[1]

    def collision_model(self) -> pin.GeometryModel:
        """Collision shapes of all arms, for :attr:`model`; an arm without shapes adds none."""
        return _assemble(self.arms, "collision")[1]


_T = TypeVar("_T")


def of_cell(make: Callable[[RobotCell], _T]) -> Callable[[RobotCell], _T]:
    """A function of a cell alone: its result is kept while the cell lives, for cells do not change."""
    kept: weakref.WeakKeyDictionary[RobotCell, _T] = weakref.WeakKeyDictionary()

    @functools.wraps(make)
    def found(cell: RobotCell) -> _T:
        if cell not in kept:
            kept[cell] = make(cell)
        return kept[cell]

    return found


@of_cell
def standing(cell: RobotCell) -> tuple[npt.NDArray[np.intp], ...]:
    """Per arm, which of its joints do not move its tool, such as a gripper's fingers or the head of a robot."""
    out = []
    for columns, tool in zip(cell.columns, cell.tool_joints, strict=True):
        moving = [cell.model.joints[j].idx_v for j in cell.model.supports[tool] if j]
        out.append(np.flatnonzero(~np.isin(columns, moving)))
    return tuple(out)


def slides(cell: RobotCell) -> list[bool]:
    """True for each velocity coordinate of a prismatic joint [m], False for a revolute one [rad]."""
    return [joint.shortname().startswith("JointModelP") for joint in list(cell.model.joints)[1:]]


def _slices(arms: Sequence[Arm], size: str) -> tuple[slice, ...]:
    ends = np.cumsum([0, *(getattr(arm.model, size) for arm in arms)])
    return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))


def _groups(arms: Sequence[Arm]) -> tuple[tuple[int, ...], ...]:
    """Arms that share joints: the indices of each group, in the order of the arms."""
    sharing: dict[str, list[int]] = {}
    for k, arm in enumerate(arms):
        if arm.shared:
            sharing.setdefault(arm.robot, []).append(k)
    return tuple(tuple(group) for group in sharing.values())


def _columns(model: pin.Model, arm: Arm) -> npt.NDArray[np.intp]:
    """The velocity coordinates of the joints of an arm's model in a cell's model."""
    names = list(arm.model.names)[1:]
    ids = [model.getJointId(f"{arm.robot if name in arm.shared else arm.name}/{name}") for name in names]
    return np.array([model.joints[i].idx_v for i in ids], dtype=np.intp)


def _limits(arms: Sequence[Arm], columns: Sequence[npt.NDArray[np.intp]], nv: int) -> JointLimits:
    """The limits of all joints; of a joint that arms share the tightest that an arm has."""
    fields = {}
    for field in LIMIT_FIELDS:
        lower = field == "lower"
        values = np.full(nv, -np.inf if lower else np.inf)
        for arm, own in zip(arms, columns, strict=True):
            values[own] = (np.maximum if lower else np.minimum)(values[own], getattr(arm.limits, field))
        fields[field] = values
    return JointLimits(**fields)


def _prefixed(arm: Arm, kind: str | None) -> tuple[pin.Model, pin.GeometryModel]:
    model = pin.Model(arm.model)
    if hasattr(model, "lowerVelocityLimit"):  # Pinocchio 4: of a joint that was added, it lies above the upper one
        model.lowerVelocityLimit = -np.asarray(model.velocityLimit)
    for i in range(1, model.njoints):
        model.names[i] = f"{arm.name}/{model.names[i]}"
    for i in range(1, model.nframes):
        model.frames[i].name = f"{arm.name}/{model.frames[i].name}"
    shapes = getattr(arm, kind) if kind else None
    geometry = pin.GeometryModel() if shapes is None else shapes.copy()
    for shape in geometry.geometryObjects:
        shape.name = f"{arm.name}/{shape.name}"
    return model, geometry


def _assemble(arms: Sequence[Arm], kind: str | None = None) -> tuple[pin.Model, pin.GeometryModel]:
    model, geometry = pin.Model(), pin.GeometryModel()
    if any(arm.shared for arm in arms):
        return assemble_shared(arms, kind)
    for arm in arms:
        own_model, own_geometry = _prefixed(arm, kind)
        model, geometry = pin.appendModel(model, own_model, geometry, own_geometry, 0, arm.T_world_base)
    return model, geometry
