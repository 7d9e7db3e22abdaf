"""The answer of load sharing: wrenches, torques, and the used share of each limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.model.limits import BindingLimit
from coopqp.spatial import Array


@dataclass(frozen=True, eq=False)
class SharedLoad:
    """The load of the arms at one instant.

    Attributes:
        wrenches: wrench of each arm on the object, at the origin and in the axes of the object frame (N, 6) [N, N·m].
        internal: the part of them that cancels (N, 6).
        torques: joint torques (nv,) [N·m or N]: the arms' own dynamics and the wrenches.
        load_torques: the part of them that the wrenches make, Jᵀ c (nv,).
        share: 1, or the largest share of the object's wrench for which the limits leave an answer.
        joint_use: share of each torque limit that is used (nv,); 0 without limit.
        grip_use: largest share of a limit of each grip that is used (N,), internal limits left out.
        internal_use: largest share of both internal limits that is used (N,).
        binding: limits that are used up, the most used first.
    """

    wrenches: Array
    internal: Array
    torques: Array
    load_torques: Array
    share: float
    joint_use: Array
    grip_use: Array
    internal_use: Array
    binding: tuple[BindingLimit, ...]

    @property
    def feasible(self) -> bool:
        """True if the arms carry the whole wrench."""
        return self.share == 1.0

    def explain(self) -> str:
        """One sentence: how much is carried, and what binds."""
        names = ", ".join(map(str, self.binding[:4])) + (", …" if len(self.binding) > 4 else "")
        if not self.feasible:
            return f"The arms carry {100.0 * self.share:.1f} % of the load ({names})."
        most = float(np.max([self.joint_use.max(), self.grip_use.max(), self.internal_use.max()]))
        return f"The arms carry the load with {100.0 * most:.1f} % of their limits{f' ({names})' if names else ''}."
