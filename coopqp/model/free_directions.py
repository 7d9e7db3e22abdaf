"""Grasps that give way in some directions: hinges, sliders, balls, pins and points, as passive joints behind the tools.

A passive joint stands between a tool and the object. It has no motor and no encoder: its position follows from the
closed chain. In the chain it is a joint of its arm, so an arm of five joints with a hinge makes every motion of the
object, and an arm of six joints gains a self-motion.

A free direction may leave the object loose: then it moves although all tools rest. With F_k the columns of the passive
joints of arm k, in one frame, that is so if a twist is in the range of every F_k: the stack of the matrices
``1 − F_k F_k⁺`` has a singular value 0. Such grasps are refused by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.checks import ArrayLike
from coopqp.errors import InvalidInputError, LooseObjectError, UnknownNameError
from coopqp.model.cell import Arm, RobotCell
from coopqp.model.grasp import Free, Grasp
from coopqp.model.state import CellState
from coopqp.spatial import Array, adjoint

#: Largest speeds of passive joints [rad/s, m/s]: nothing drives them, and nothing of theirs limits the object.
_SPIN, _SPEED = 20.0, 5.0
#: Below this singular value an object is loose; twists count in units of the grasps' distance.
LOOSE = 1e-3
#: Newton steps of an estimate, and the change that ends them [rad or m].
_STEPS, _SETTLED = 20, 1e-12


@dataclass(frozen=True, eq=False)
class FreedCell:
    """A cell whose free directions are joints.

    Attributes:
        cell: the arms with their passive joints, which are named ``arm/free_rx`` and so on.
        grasp: the grasp without free directions, of these arms.
        passive: velocity coordinates of the passive joints in ``cell`` (P,).
        actuated: velocity coordinates of all others (nv − P,): what is sent to the robots.
    """

    cell: RobotCell
    grasp: Grasp
    passive: npt.NDArray[np.intp]

    @cached_property
    def actuated(self) -> npt.NDArray[np.intp]:
        """See the class."""
        return np.setdiff1d(np.arange(self.cell.nv), self.passive)

    def configuration(self, x: ArrayLike, *, near: ArrayLike | None = None) -> Array:
        """The configuration (nq,) with the passive joints where the closed chain puts them.

        Args:
            x: positions of the actuated joints (nv − P,), as commanded or measured [rad or m].
            near: a configuration (nq,) from which the passive joints are sought; by default all are at 0.

        Raises:
            InvalidInputError: another number of joints.
        """
        own = np.asarray(x, dtype=float)
        if own.shape != self.actuated.shape or not np.isfinite(own).all():
            raise InvalidInputError(
                f"shape {own.shape}", "FreedCell.configuration", f"Give {self.actuated.size} positions of joints."
            )
        full = np.zeros(self.cell.nv) if near is None else self.cell.positions(np.asarray(near, dtype=float)).copy()
        full[self.actuated] = own
        for _ in range(_STEPS):
            residual, J = self._closure(full)
            step = np.linalg.lstsq(J, -residual, rcond=None)[0]
            full[self.passive] += np.clip(step, -0.5, 0.5)
            if np.abs(step).max(initial=0.0) < _SETTLED:
                break
        return self.cell.configuration(full)

    def _closure(self, x: Array) -> tuple[Array, Array]:
        """How the arms' views of the object differ from the first one's (6 (N − 1),), and by the passive joints."""
        state = CellState(self.cell, self.cell.configuration(x))
        O = self.grasp.carried(state)
        columns = []
        for k, own in enumerate(self.cell.v_slices):  # twists of the object, in the frame of the first view
            J = np.zeros((6, self.cell.nv))
            X = self.grasp.T_object_tool[k]
            J[:, own] = adjoint(O[0].inverse() * O[k] * X) @ state.jacobian(k)
            columns.append(J[:, self.passive])
        errors = [np.asarray(pin.log6(O[0].actInv(other)).vector) for other in O[1:]]
        slopes = [own - columns[0] for own in columns[1:]]
        if not errors:
            return np.zeros(0), np.zeros((0, self.passive.size))
        return np.concatenate(errors), np.vstack(slopes)


def freed_cell(cell: RobotCell, grasp: Grasp) -> FreedCell:
    """The cell in which the free directions of a grasp are passive joints behind the tools.

    Args:
        cell: the arms.
        grasp: how they hold, with free directions (:meth:`Grasp.freed`).

    Raises:
        LooseObjectError: the object is loose.
        InvalidInputError: there is not one placement per arm, or arms share joints.
        UnknownNameError: no such arm.
    """
    for free in grasp.free:
        if free.arm not in cell.arm_names:
            raise UnknownNameError("arm", free.arm, cell.arm_names, "Grasp.freed")
    rigid = Grasp(grasp.T_object_tool)
    rigid.check_arms(cell)
    cell.refuse_shared("freed_cell")
    refuse_loose(cell.arm_names, grasp)
    arms = []
    for arm in cell.arms:
        own = [free for free in grasp.free if free.arm == arm.name]
        arms.append(_with_passive(arm, own) if own else arm)
    made = RobotCell(arms)
    passive = [j for j, name in enumerate(made.joint_names) if name.partition("/")[2].startswith("free_")]
    return FreedCell(made, rigid, np.array(passive, dtype=np.intp))


def refuse_loose(arms: Sequence[str], grasp: Grasp, holding: Sequence[bool] | None = None) -> None:
    """Refuse a grasp in which the object moves although all tools that hold it rest.

    Args:
        arms: names of all arms.
        grasp: how they hold, with free directions.
        holding: which of them hold (N,); None: all do.

    Raises:
        LooseObjectError: it is loose; the message says in which direction.
    """
    value, twist = looseness(arms, grasp, holding)
    if value >= LOOSE:
        return
    v, w = twist[:3], twist[3:]
    turns = np.linalg.norm(w) > 1e-6
    way = w / np.linalg.norm(w) if turns else v / np.linalg.norm(v)
    kind = "turn about" if turns else "slide along"
    raise LooseObjectError(
        f"The object is loose: it can {kind} ({', '.join(f'{x:.2g}' for x in way)}) of its frame while all tools rest. "
        "Free fewer directions, or hold it with another arm."
    )


def looseness(arms: Sequence[str], grasp: Grasp, holding: Sequence[bool] | None = None) -> tuple[float, Array]:
    """The least singular value of the stack of ``1 − F_k F_k⁺``, 0 for a loose object, and its twist (6,).

    The twist is in the object frame at its origin; the value counts distances in units of that of the grasps.
    """
    kept = [k for k in range(len(grasp)) if holding is None or holding[k]]
    points = np.array([grasp.T_object_tool[k].translation for k in kept])
    centre = points.mean(axis=0)
    unit = max(float(np.linalg.norm(points - centre, axis=1).max()), 0.1)
    scale = np.repeat([1.0 / unit, 1.0], 3)  # of twists at the centre
    to_centre = adjoint(pin.SE3(np.eye(3), -centre))
    rows = []
    for k in kept:
        own = [free.column(grasp.T_object_tool[k]) for free in grasp.free if free.arm == arms[k]]
        if not own:
            rows.append(np.eye(6))
            continue
        U, s, _ = np.linalg.svd(scale[:, None] * (to_centre @ np.column_stack(own)), full_matrices=False)
        U = U[:, s > 1e-9 * s[0]]
        rows.append(np.eye(6) - U @ U.T)
    _, values, Vt = np.linalg.svd(np.vstack(rows))
    twist: Array = np.linalg.inv(to_centre) @ (Vt[-1] / scale)
    return float(values[-1]), twist


def _with_passive(arm: Arm, free: Sequence[Free]) -> Arm:
    """The arm with passive joints behind its tool, in the order in which they were given."""
    model = pin.Model(arm.model)
    frame = model.frames[model.getFrameId(arm.tool_frame)]
    parent, place = frame.parentJoint, frame.placement
    ends: list[tuple[float, float, float]] = []
    for one in free:
        joint = getattr(pin, f"JointModel{'R' if one.turns else 'P'}{one.axis[-1].upper()}")()
        low, high = one.low, one.high
        speed = _SPIN if one.turns else _SPEED
        bounds = (np.array([x]) for x in (0.0, speed, low, high))
        parent = model.addJoint(parent, joint, place, f"free_{one.axis}", *bounds)
        place = pin.SE3.Identity()
        ends.append((low, high, speed))
    name = f"{arm.tool_frame} (freed)"
    model.addFrame(pin.Frame(name, parent, 0, place, pin.FrameType.OP_FRAME))
    old, low, high, speed = arm.limits, *np.array(ends).T
    added = dict(zip(("lower", "upper", "velocity"), (low, high, speed), strict=True))
    limits = {field: np.concatenate([getattr(old, field), more]) for field, more in added.items()}
    limits["acceleration"] = np.concatenate([old.acceleration, np.full(len(ends), np.inf)])
    return replace(arm, model=model, tool_frame=name, limits=replace(old, **limits))
