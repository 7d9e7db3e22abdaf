"""Joints that follow others: the ``mimic`` joints of a URDF, the ``joint`` equalities of an MJCF.

A joint that follows another has no command of its own. The chain of an arm has one motor per joint, so a follower is
locked where its leader stands; one that would have to move with the tool, or whose leader moves it, is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from coopqp.errors import ModelError

#: By how much a locked follower may be off the place that its locked leader gives it [rad or m]: typed numbers.
_AGREE = 1e-3


@dataclass(frozen=True)
class Follower:
    """A joint that follows another.

    Attributes:
        leader: the joint that it follows, which may follow another itself; empty for one that is held where it is.
        coefficients: its position is ``Σ_k coefficients[k] · (x − leader_zero)^k`` of the leader's x [rad or m].
        leader_zero: see above [rad or m].
    """

    leader: str
    coefficients: tuple[float, ...]
    leader_zero: float = 0.0

    def at(self, x: float) -> float:
        """Its position at the leader's [rad or m]."""
        return float(np.polyval(self.coefficients[::-1], x - self.leader_zero))


def urdf_followers(root: ElementTree.Element, where: str) -> dict[str, Follower]:
    """The followers of a URDF by their names, in any order.

    Raises:
        ModelError: a ``mimic`` element names no joint, or has factors that are no numbers.
    """
    found = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is None or joint.get("type") == "fixed":
            continue
        name = joint.get("name", "")
        try:
            factors = float(mimic.get("offset", "0")), float(mimic.get("multiplier", "1"))
        except ValueError as error:
            raise ModelError(f"{where}: the mimic element of joint '{name}' has bad numbers: {error}.") from error
        if not np.isfinite(factors).all() or not mimic.get("joint"):
            raise ModelError(f"{where}: the mimic element of joint '{name}' needs a joint and finite numbers.")
        found[name] = Follower(mimic.get("joint", ""), factors)
    return found


def followers_locked(
    where: str, model: pin.Model, followers: Mapping[str, Follower], tools: Iterable[str], given: Mapping[str, float]
) -> dict[str, float]:
    """The joints to lock with their positions: those given, all followers, and the leaders that move no tool with them.

    Args:
        where: beginning of messages.
        model: with the followers as joints of their own.
        followers: by their names.
        tools: frames that are moved.
        given: positions of joints that are locked anyway [rad or m].

    Raises:
        ModelError: a follower or its leader moves a tool, is locked where it cannot be, or follows no joint.
    """
    held = {name: follower.at(0.0) for name, follower in followers.items() if not follower.leader}
    given = {**{name: at for name, at in held.items() if model.existJointName(name)}, **given}
    moving, out = _moving(model, tools), dict(given)
    for name in followers:
        if model.existJointName(name):
            _lock_follower(where, model, followers, name, moving, given, out)
    return out


def refuse_loops(
    where: str,
    model: pin.Model,
    loops: Mapping[str, frozenset[str]],
    tools: Iterable[str],
    locked: Mapping[str, float],
) -> None:
    """Raise ModelError for joints that depend on each other and move a tool."""
    moving = _moving(model, tools).difference(locked)
    for loop, joints in loops.items():
        if len(joints.difference(locked)) and (held := sorted(joints & moving)):
            raise ModelError(
                f"{where}: {loop} holds joint '{held[0]}', which moves the tool; coopqp moves each joint by itself. "
                f"Lock what it holds ({', '.join(sorted(joints))}), or take it out in a copy of the file."
            )


def _moving(model: pin.Model, tools: Iterable[str]) -> set[str]:
    """Names of the joints that move tools; tools that are not there are named elsewhere."""
    return {
        model.names[j]
        for tool in tools
        if isinstance(tool, str) and model.existFrame(tool)
        for j in model.supports[model.frames[model.getFrameId(tool)].parentJoint]
    }


def _lock_follower(
    where: str,
    model: pin.Model,
    followers: Mapping[str, Follower],
    name: str,
    moving: set[str],
    given: Mapping[str, float],
    out: dict[str, float],
) -> None:
    line = [name]  # it, its leader, the leader's leader, to one that is locked or follows none
    while line[-1] in followers and (len(line) == 1 or line[-1] not in given):
        leader = followers[line[-1]].leader
        if not leader:
            break
        if leader in line or not model.existJointName(leader):
            if name in given:
                return
            wrong = "itself" if leader in line else f"'{leader}', which is no moving joint of the model"
            raise ModelError(
                f"{where}: joint '{name}' follows {wrong}. Say where it stands: locked_joints={{'{name}': …}}."
            )
        line.append(leader)
    first = line[-1]
    if first not in given:
        if first in moving:
            how = "moves the tool with it" if name in moving else "moves the tool"
            remedy = "" if name in moving else f", or make '{name}' a fixed joint in a copy of the file"
            raise ModelError(
                f"{where}: joint '{name}' follows joint '{first}', which {how}. coopqp moves each joint by itself: "
                f"locked while the other moves, '{name}' would make another robot. Lock '{first}', and both "
                f"stand still{remedy}."
            )
        if name in given:  # a finger that nothing moves stands where it is said to
            return
        if name in moving:
            raise ModelError(
                f"{where}: joint '{name}' follows joint '{first}' and moves the tool. Lock '{first}' where it stands; "
                f"'{name}' then stands where it takes it."
            )
        out.setdefault(first, _nearest_zero(model, first))
    x = out[first]
    for joint in line[-2::-1]:
        x = followers[joint].at(x)
    if name in given and abs(given[name] - x) > _AGREE:
        raise ModelError(
            f"{where}: joint '{name}' follows joint '{first}' and stands at {x:g} where that one is locked at "
            f"{out[first]:g}, not at {given[name]:g}. Lock '{first}' alone."
        )
    out.setdefault(name, x)


def _nearest_zero(model: pin.Model, joint: str) -> float:
    own = model.joints[model.getJointId(joint)]
    low, high = float(model.lowerPositionLimit[own.idx_q]), float(model.upperPositionLimit[own.idx_q])
    return float(np.clip(0.0, low, high)) if own.nq == 1 and low <= high else 0.0
