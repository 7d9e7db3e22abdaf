"""Forces and torques of a recorded run: internal forces, and the used share of each limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.forces.frictional_contacts import palm_use
from coopqp.forces.grips import Grip
from coopqp.forces.internal import internal_wrenches
from coopqp.model.cell import RobotCell
from coopqp.simulation.recording.recording import Recording, RecordingError
from coopqp.spatial import Array


@dataclass(frozen=True, eq=False)
class RunLoads:
    """Forces and torques after each of the T steps of a run.

    Attributes:
        time: (T,) [s].
        torque_use: share of each joint's largest torque that is used (T, nv); 0 without limit.
        palm_use: share of each palm's friction and pad that is used (T, N); None for grips.
        internal: size of each arm's internal force on the object (T, N) [N].
        internal_limit: the largest accepted one [N]; inf for any.
        moves: index of the first step in which the object moves; T if it never does.
    """

    time: Array
    torque_use: Array
    internal: Array
    internal_limit: float
    moves: int
    palm_use: Array | None = None

    def figures(self, cell: RobotCell) -> dict[str, str]:
        """The key figures by name, with their units."""
        i, j = _largest(self.torque_use)
        most = f"{100.0 * self.torque_use[i, j]:.1f} %"
        out = {"torque, most used": f"{most} ({cell.joint_names[j]}, {self.time[i]:.2f} s)"}
        for k, arm in enumerate(cell.arm_names):
            own = self.torque_use[:, cell.v_slices[k]]
            out[f"torque of {arm}"] = f"{100.0 * own.max():.1f} % of its limit"
        if self.palm_use is not None and self.moves < len(self.time):
            i, j = _largest(self.palm_use[self.moves :])
            most = f"{100.0 * self.palm_use[self.moves + i, j]:.1f} %"
            out["friction, most used"] = f"{most} ({cell.arm_names[j]}, {self.time[self.moves + i]:.2f} s)"
        moving = self.internal[self.moves :]
        if moving.size and self.palm_use is None:
            i, j = _largest(moving)
            where = f"{cell.arm_names[j]}, {self.time[self.moves + i]:.2f} s"
            out["internal force in motion"] = f"{moving[i, j]:.1f} N ({where})"
        what = "internal force" if self.palm_use is None else "squeeze"
        out[f"{what} at the end"] = f"{self.internal[-1].max():.1f} N"
        return out

    def overloaded(self, cell: RobotCell) -> tuple[str, str]:
        """The used share of the torques in words; and the cause if it is too much."""
        use = self.torque_use
        i, j = _largest(use)
        text = f"at most {100.0 * use[i, j]:.1f} % of a torque ({cell.joint_names[j]})"
        over = np.flatnonzero(use[:, j] > 1.0)
        return text, f"{cell.joint_names[j]}: torque, since {self.time[over[0]]:.3f} s" if over.size else ""

    def held(self, cell: RobotCell) -> tuple[str, str]:
        """Whether the palms held the object to the end; and the cause if they did not.

        Friction may be used up for moments. The object is lost when a palm no longer presses.
        """
        if self.palm_use is None or self.moves == len(self.time):
            return "the object did not move", ""
        use = self.palm_use[self.moves :]
        lost = np.flatnonzero(~np.isfinite(use).all(axis=1))
        if not lost.size:
            i, j = _largest(use)
            return f"at most {100.0 * use[i, j]:.0f} % of a palm's friction ({cell.arm_names[j]})", ""
        arm = cell.arm_names[int(np.argmax(~np.isfinite(use[lost[0]])))]
        return f"arm {arm} let go", f"arm {arm}: friction, since {self.time[self.moves + lost[0]]:.3f} s"

    def squeezed(self, cell: RobotCell) -> tuple[str, str]:
        """The internal forces in motion in words; and the cause where they are too large."""
        moving = self.internal[self.moves :]
        if not moving.size:
            return "the object did not move", ""
        largest = moving.max(axis=1)
        text = f"internal force ≤ {largest.max():.1f} N in motion"
        text += f" (accepted: {self.internal_limit:g} N)" if np.isfinite(self.internal_limit) else ""
        over = np.flatnonzero(largest > self.internal_limit)
        if not over.size:
            return text, ""
        arm = cell.arm_names[int(moving[over[0]].argmax())]
        return text, f"arm {arm}: internal force, since {self.time[self.moves + over[0]]:.3f} s"


def _largest(rows: Array) -> tuple[int, int]:
    i, j = np.unravel_index(int(rows.argmax()), rows.shape)
    return int(i), int(j)


def read_loads(cell: RobotCell, recording: Recording) -> RunLoads | None:
    """The loads of a run; None if it was recorded without them.

    Raises:
        InvalidInputError: the recording is of another cell.
        RecordingError: the entry ``load`` of its metadata is damaged.
    """
    wrenches, torques = recording.wrenches, recording.torques
    if wrenches is None or torques is None or not recording.n_steps:
        return None
    if torques.shape[1] != cell.nv or wrenches.shape[1] != len(cell):
        raise InvalidInputError("forces of another cell", "recording", "Use the cell that the run was made with.")
    entry = recording.metadata.get("load", {})
    try:
        given = entry.get("torque_limits") or [None] * cell.nv
        limits = np.array([np.inf if x is None else float(x) for x in given])
        cap = entry.get("internal_force")
        largest = np.inf if cap is None else float(cap)
        palms = None if entry.get("palms") is None else [Grip(**one) for one in entry["palms"]]
        if len(limits) != cell.nv or (palms is not None and [p.kind for p in palms] != ["palm"] * len(cell)):
            raise ValueError("not one limit for each joint, or one palm for each arm")
        use = np.abs(torques) / limits
    except (CoopqpError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise RecordingError(f"'load' in the recording's metadata is damaged ({error}).") from error
    internal = internal_wrenches(wrenches, recording.grasp)
    moving = np.flatnonzero(recording.rate > 0.0)
    return RunLoads(
        time=recording.time[1:],
        torque_use=use,
        internal=np.linalg.norm(internal[:, :, :3], axis=2),
        internal_limit=largest,
        palm_use=None if palms is None else np.array([palm_use(palms, row) for row in wrenches]),
        moves=int(moving[0]) if moving.size else recording.n_steps,
    )
