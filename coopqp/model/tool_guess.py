"""Where an arm's description ends in a tool: its frame, the joints of its fingers, and which axis points out of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp.errors import ModelError
from coopqp.model.arm import Arm
from coopqp.model.description import description_file, read_urdf
from coopqp.model.followers import Follower, urdf_followers
from coopqp.model.joint_limits import UNLIMITED
from coopqp.model.urdf_faults import urdf_fault

#: Names of joints that move fingers.
_FINGERS = re.compile(r"finger|grip|jaw|knuckle|thumb|claw", re.I)
#: Names of frames that hold objects, the surest first.
_TOOLS = (r"tcp|tool_?center", r"tool_?0$", r"tool", r"(^|_)eef?(_|$)|end_?effector|grasp", r"flange", r"hand|gripper")
#: A tool's offset from its joint that tells where it points [m].
_OFFSET = 0.01


@dataclass(frozen=True, kw_only=True)
class ToolGuess:
    """A guess at the tool of a robot description.

    Attributes:
        tool_frame: the frame that is to hold the object.
        locked: joints of fingers with positions for them [rad or m], without those that follow them.
        others: frames on the same link of the chain, which may be meant instead.
    """

    tool_frame: str
    locked: dict[str, float]
    others: tuple[str, ...]


def guess_tool(file: str | Path, *, tool_frame: str | None = None) -> ToolGuess:
    """Guess tool frame and fingers of a URDF with one arm.

    Fingers are joints that are named so, that mimic others, or that end beside each other; and what stands beside or
    behind one. The tool is on the last link of the longest chain without them; of its frames the name decides, then
    the place in the file. Sliding fingers are locked in the middle of their range, others at zero.

    Args:
        file: the URDF.
        tool_frame: the frame that holds the object, if it is known: only fingers are guessed.

    Raises:
        ModelError: the file is no readable URDF, nothing moves in it, or several chains are equally long: the message
            lists the ends.
    """
    source = description_file(file, Path(file).stem)
    root = read_urdf(source, source.stem)
    followers = urdf_followers(root, str(source))
    try:
        model = pin.buildModelFromUrdf(str(source))
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"{source} is not a readable URDF ({urdf_fault(root) or error}).") from error
    fingers = _fingers(model, set(followers))
    links = [f for f in model.frames if f.type == pin.FrameType.BODY and f.name != "universe"]
    if tool_frame is not None:
        named = [f for f in model.frames if f.name == tool_frame]
        if not named:
            raise ModelError(f"{source} has no frame '{tool_frame}': {', '.join(f.name for f in links)}.")
        moving = {int(j) for j in model.supports[named[0].parentJoint]}
        return _guess(model, tool_frame, fingers - moving, (), followers)
    arms = [j for j in range(1, model.njoints) if j not in fingers]
    ends = [j for j in arms if not any(int(child) in arms for child in model.subtrees[j][1:])]
    longest = max((len(model.supports[j]) for j in ends), default=0)
    last = [j for j in ends if len(model.supports[j]) == longest]
    if not last:
        raise ModelError(f"nothing moves in {source}: it has no joints besides those of fingers.")
    names = {j: _ranked([f.name for f in links if f.parentJoint == j]) for j in last}
    if len(last) > 1:
        found = ", ".join(names[j][0] for j in last)
        raise ModelError(f"{source} has several ends: {found}. Say which: {source.name}:{names[last[0]][0]}.")
    first, *others = names[last[0]]
    return _guess(model, first, fingers, tuple(others), followers)


def _guess(
    model: pin.Model, frame: str, fingers: set[int], others: tuple[str, ...], followers: Mapping[str, Follower]
) -> ToolGuess:
    names = {model.names[j]: j for j in sorted(fingers)}  # those that follow one of them stand where it takes them
    locked = {n: _rest(model, j) for n, j in names.items() if n not in followers or followers[n].leader not in names}
    return ToolGuess(tool_frame=frame, locked=locked, others=others)


def _fingers(model: pin.Model, mimics: set[str]) -> set[int]:
    """Joints that move fingers."""
    children = {j: [int(c) for c in range(1, model.njoints) if model.parents[c] == j] for j in range(model.njoints)}
    found = {j for j in range(1, model.njoints) if model.names[j] in mimics or _FINGERS.search(model.names[j])}
    for beside in children.values():
        leaves = [j for j in beside if not children[j]]
        if len(leaves) > 1:
            found.update(leaves)
        if found.intersection(beside) and beside != children[0]:
            found.update(beside)
    return {int(j) for finger in found for j in model.subtrees[finger]}


def _ranked(names: list[str]) -> list[str]:
    """Frames of a link, that which is most likely the tool first; the last of a file is the farthest out."""
    if not names:
        raise ModelError("the last joint carries no link.")

    def rank(name: str) -> int:
        return next((i for i, words in enumerate(_TOOLS) if re.search(words, name, re.I)), len(_TOOLS))

    return sorted(reversed(names), key=rank)


def _rest(model: pin.Model, joint: int) -> float:
    """Where a finger is locked [rad or m]: sliding in the middle of its range, else at zero or the limit nearest."""
    at = model.joints[joint].idx_q
    low, high = float(model.lowerPositionLimit[at]), float(model.upperPositionLimit[at])
    if not low <= high:
        return 0.0
    if model.joints[joint].shortname().startswith("JointModelP") and max(-low, high) < UNLIMITED:
        return round(0.5 * (low + high), 6)
    return float(np.clip(0.0, low, high))


def axis_out(arm: Arm) -> tuple[float, float, float]:
    """The tool's own axis, with its sign, that points out of the hand: along its offset from the last joint; else z."""
    frame = arm.model.frames[arm.model.getFrameId(arm.tool_frame)]
    offset = frame.placement.rotation.T @ frame.placement.translation
    axis = np.zeros(3)
    along = int(np.abs(offset).argmax()) if np.linalg.norm(offset) > _OFFSET else 2
    axis[along] = -1.0 if offset[along] < -_OFFSET else 1.0
    return float(axis[0]), float(axis[1]), float(axis[2])
