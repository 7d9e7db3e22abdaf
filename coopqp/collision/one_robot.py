"""Bodies of one robot that a cell has as several arms: its fixed links are there once, and belong to each of its arms.

Every arm of a description has all of its fixed links. Those of them that lie on the way to an arm's tool are its own;
what lies on no way, such as a head, belongs to all arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import final

import numpy as np

from coopqp.collision.built_scene import Part
from coopqp.model.cell import Arm, RobotCell

#: Links of one name whose places differ by no more than this are one [m, and rotation matrix entries].
_SAME = 1e-6


@final
class OneRobot:
    """Which arms of a cell are of one description, and which of their links are one.

    Args:
        cell: the arms.
    """

    def __init__(self, cell: RobotCell) -> None:
        self._cell = cell
        self._first = [
            next(i for i, other in enumerate(cell.arms[: k + 1]) if _same_robot(other, arm))
            for k, arm in enumerate(cell.arms)
        ]

    def names_of(self, arm: str) -> tuple[str, ...]:
        """What stands before the names of an arm's links, and of those of the arms of its description."""
        cell, first = self._cell, self._first
        arms = [cell.arms[k] for k in range(len(cell)) if first[k] == first[cell.index(arm)]]
        return tuple(dict.fromkeys([*(a.name for a in arms), *(a.robot for a in arms if a.shared)]))

    @cached_property
    def _ways(self) -> tuple[frozenset[str], ...]:
        """Names of the frames from the base to each arm's tool."""
        out = []
        for arm in self._cell.arms:
            names, i = set(), arm.model.getFrameId(arm.tool_frame)
            while i > 0:
                names.add(arm.model.frames[i].name)
                i = arm.model.frames[i].parentFrame if arm.model.frames[i].parentFrame != i else 0
            out.append(frozenset(names))
        return tuple(out)

    def owners(self, part: Part) -> frozenset[str]:
        """The arms to which a part belongs that is fixed to the world: none for what is no link of an arm."""
        if part.joint or not part.frame:
            return frozenset()
        cell = self._cell
        arm, _, link = cell.model.frames[part.frame].name.partition("/")
        if arm not in cell.arm_names:
            return frozenset()
        own = self._first[cell.index(arm)]
        arms = [k for k in range(len(cell)) if self._first[k] == own]
        return frozenset(cell.arm_names[k] for k in ([k for k in arms if link in self._ways[k]] or arms))

    def copies(self, parts: Sequence[Part]) -> dict[str, str]:
        """Names of links that are there for another arm already, and the names that they have there."""
        cell, frames = self._cell, self._cell.model.frames
        found: dict[tuple[int, str], list[Part]] = {}
        for part in parts:
            arm, _, link = frames[part.frame].name.partition("/")
            if not part.joint and part.frame and part.name == frames[part.frame].name and arm in cell.arm_names:
                found.setdefault((self._first[cell.index(arm)], link), []).append(part)
        out = {}
        for same in found.values():
            owners = self.owners(same[0])
            kept = next((part for part in same if part.name.partition("/")[0] in owners), same[0])
            place = frames[kept.frame].placement.homogeneous
            for part in same:
                if part.name != kept.name and np.abs(frames[part.frame].placement.homogeneous - place).max() <= _SAME:
                    out[part.name] = kept.name
        return out


def _same_robot(a: Arm, b: Arm) -> bool:
    """Two arms are of one robot: told so, or of one description at one place."""
    if a is b or (a.robot and a.robot == b.robot):
        return True
    away = np.abs(a.T_world_base.homogeneous - b.T_world_base.homogeneous).max()
    return a.source == b.source and bool(away <= _SAME)
