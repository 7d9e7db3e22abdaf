"""The check of an arm that follows ways of its joints along a path: the tool's path between them, part by part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp.constraints.samples import PathSamples
from coopqp.core._core import FAR_FROM_WAY
from coopqp.errors import InvalidInputError
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import amount
from coopqp.paths.certificate import PathVerdict, worst
from coopqp.paths.joint_path import JointPiece
from coopqp.paths.path import ObjectPath
from coopqp.planning.branch_checks import BranchCheck, check_branches, not_disproved
from coopqp.planning.tools_on_object import tool_on_object
from coopqp.spatial import Array

#: Parts of a path that are shorter than this are none [s].
_SHORTEST = 1e-9


def ways_of(path: ObjectPath, k: int) -> tuple[JointPiece, ...]:
    """The ways of its joints that arm k follows along a path."""
    motion = getattr(path, "grasps", None)
    return motion.led[k] if motion is not None and motion.leads else ()


def check_with_ways(
    kinematics: ArmKinematics, path: ObjectPath, samples: PathSamples, k: int, X: pin.SE3, start: Array
) -> BranchCheck:
    """The verdict on an arm from a start: it follows its tool's path to each way, and goes on from the end of that.

    A way itself is inside the position limits where its rows are, which a program has seen to.

    Args:
        kinematics, k, X: the arm, its number, and its T_object_tool of the grasp.
        path, samples: the object's path; as arm k sees it.
        start: joint positions (n,) [rad or m] at its start.
    """
    parts, ways, x, clock = list[BranchCheck](), ways_of(path, k), start, 0.0
    for way in (*ways, None):
        end = path.duration if way is None else way.start
        if end > clock + _SHORTEST:
            tool = tool_on_object(path, samples, k, X, begin=clock, end=end)
            found = not_disproved(kinematics, tool, check_branches(kinematics, tool, x[None]))[0]
            parts.append(found)
            if found.until < end - _SHORTEST or found.verdict is PathVerdict.INFEASIBLE:
                return _joined(parts, ways, found.until)
            x = found.q[-1]
        if way is None:
            break
        off = np.abs(x - way.at(way.start)[0])
        j = int(off.argmax())
        if off[j] > FAR_FROM_WAY:
            far = amount(float(off[j]), slides=bool(kinematics.slides[j]))
            why = f"comes to the way of its joints with {kinematics.joints[j]} {far} from where that begins"
            last = parts[-1] if parts else None
            if last is None:
                raise InvalidInputError(f"arm '{kinematics.arm.name}' {why}", "check_path: q_start", "Start there.")
            parts[-1] = replace(last, verdict=PathVerdict.INFEASIBLE, why=why, until=way.start)
            return _joined(parts, ways, way.start)
        x, clock = way.at(way.end)[0], way.end
    return _joined(parts, ways, path.duration)


def _joined(parts: Sequence[BranchCheck], ways: Sequence[JointPiece], until: float) -> BranchCheck:
    """The parts as one, up to a clock [s]; its samples are those of the tool's path."""
    verdict = worst([part.verdict for part in parts])
    by = next(part for part in parts if part.verdict is verdict)
    rows = np.array([part.margins for part in parts])
    which = rows.argmin(axis=0)
    margins, clocks = rows.min(axis=0), np.array([part.margin_clocks for part in parts])[which, range(rows.shape[1])]
    passed = np.array([[way.start, way.end] for way in ways if way.end <= until + _SHORTEST]).reshape(-1, 2)
    return replace(
        by,
        verdict=verdict,
        until=until,
        margins=margins,
        margin_clocks=clocks,
        certified=np.vstack([passed, *(part.certified.reshape(-1, 2) for part in parts)]),
        undecided=np.vstack([part.undecided.reshape(-1, 2) for part in parts]),
        sigma_bound=min(part.sigma_bound for part in parts),
        clocks=np.concatenate([part.clocks for part in parts]),
        q=np.concatenate([part.q for part in parts]),
        sigma_min=np.concatenate([part.sigma_min for part in parts]),
        manipulability=np.concatenate([part.manipulability for part in parts]),
    )
