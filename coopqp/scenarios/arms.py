"""Arms by name: those that come with coopqp, and every single arm of ``example-robot-data`` (extra ``robots``)."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pinocchio as pin

from coopqp.errors import InvalidInputError, MissingExtraError, UnknownNameError
from coopqp.model.cell import Arm
from coopqp.scenarios.robots import robot_path
from coopqp.spatial import Placement

_PACKAGE = "example-robot-data"


@dataclass(frozen=True, kw_only=True)
class RobotEntry:
    """An arm with a name of its own.

    Attributes:
        joints: number of moving joints.
        tool_frame: the frame that holds the object, unless another is given.
        licence: licence of the description.
        source: who made the robot, and where the description comes from.
        file: end of the file's name in ``example-robot-data``; empty for a robot that comes with coopqp.
        locked: joints that do not move the tool, with their positions [rad or m].
        acceleration: published acceleration limits [rad/s²]; empty for none.
    """

    joints: int
    tool_frame: str
    licence: str
    source: str
    file: str = ""
    locked: tuple[tuple[str, float], ...] = ()
    acceleration: tuple[float, ...] = ()

    @property
    def extra(self) -> str:
        """The extra that installs the robot; empty if it comes with coopqp."""
        return "robots" if self.file else ""


def _listed() -> dict[str, RobotEntry]:
    entries = json.loads((Path(__file__).parent / "robots" / "robots.json").read_text(encoding="utf-8"))
    for entry in entries.values():
        entry["locked"] = tuple(entry.get("locked", {}).items())
        entry["acceleration"] = tuple(entry.get("acceleration", ()))
    return {name: RobotEntry(**entry) for name, entry in entries.items()}


#: Every arm with a name of its own, listed in ``robots/robots.json``.
ROBOTS: Mapping[str, RobotEntry] = MappingProxyType(_listed())


def robot_data_path(name: str) -> Path:
    """Path of a file of ``example-robot-data``, from the end of its name in the package, e.g. ``"urdf/panda.urdf"``.

    Raises:
        MissingExtraError: the package is not installed or has no such file.
    """
    from importlib import metadata  # late: it imports much

    try:
        root = Path(str(metadata.distribution(_PACKAGE).locate_file("")))
    except metadata.PackageNotFoundError as error:
        raise MissingExtraError("robots", _PACKAGE) from error
    for file in _data_files(root):
        if file.endswith(name):
            return (root / file).resolve()
    raise MissingExtraError("robots", f"{_PACKAGE} with a file {name}")


@functools.cache
def _data_files(root: Path) -> tuple[str, ...]:
    """Names of the package's files where it is installed in ``root``: some thousand."""
    from importlib import metadata

    return tuple(map(str, metadata.distribution(_PACKAGE).files or ()))


def robot_file(robot: str) -> Path:
    """Path of the URDF of a robot of :data:`ROBOTS`. Errors as :func:`robot_arm`."""
    if not isinstance(robot, str) or robot not in ROBOTS:
        raise UnknownNameError("robot", str(robot), ROBOTS)
    made = ROBOTS[robot]
    return robot_data_path(made.file) if made.file else robot_path(robot)


def robot_arm(
    robot: str,
    *,
    name: str | None = None,
    T_world_base: Placement | None = None,
    tool_frame: str | None = None,
    geometry: bool = True,
    locked_joints: Mapping[str, float] | None = None,
    **limits: Any,
) -> Arm:
    """An arm of :data:`ROBOTS`, with its meshes, its fingers locked and its published acceleration limits.

    Args:
        robot: name of the robot.
        name: name of the arm in its cell; by default the robot's.
        T_world_base: placement of its base in the world (identity by default).
        tool_frame: the frame that holds the object; by default the robot's.
        geometry: also load the shapes.
        locked_joints: further joints to lock, with their positions [rad or m].
        limits: ``velocity``, ``acceleration``, ``lower`` or ``upper``, as in :meth:`Arm.with_limits`.

    Raises:
        UnknownNameError: no such robot, frame, joint or limit.
        MissingExtraError: the robot needs the extra ``robots``.
        InvalidInputError, ModelError: as in :meth:`Arm.from_urdf`.
    """
    file = robot_file(robot)
    if locked_joints is not None and not isinstance(locked_joints, Mapping):
        raise InvalidInputError(
            f"locked_joints is a {type(locked_joints).__name__}", "robot_arm", "Give a dictionary of joints."
        )
    made = ROBOTS[robot]
    locked = {**dict(made.locked), **(locked_joints or {})}
    frame = tool_frame or made.tool_frame
    try:
        arm = _read(robot, file, frame, bool(geometry), tuple(sorted(locked.items())))
    except TypeError:  # a position that is no key of a cache; the reader names it
        arm = _read.__wrapped__(robot, file, frame, bool(geometry), tuple(locked.items()))
    placed = arm.placed(pin.SE3.Identity() if T_world_base is None else T_world_base, name=name)
    return placed.with_limits(**limits) if limits else placed


@functools.lru_cache(maxsize=32)
def _read(robot: str, file: Path, tool_frame: str, geometry: bool, locked: tuple[tuple[str, float], ...]) -> Arm:
    """An arm at the origin. It is read only once."""
    made = ROBOTS[robot]
    return Arm.from_urdf(
        robot,
        file,
        tool_frame=tool_frame,
        geometry=geometry,
        locked_joints=dict(locked) or None,
        acceleration_limits=made.acceleration if made.acceleration and len(made.locked) == len(locked) else None,
    )


def robot_table() -> str:
    """The robots as text: name, joints, tool frame, licence and source; robots of the extra ``robots`` are marked."""
    rows = [("robot", "joints", "tool frame", "licence", "source")]
    rows += [
        (name + ("*" if made.extra else ""), str(made.joints), made.tool_frame, made.licence, made.source)
        for name, made in ROBOTS.items()
    ]
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([*lines, "", "* needs the extra robots: pip install 'coopqp[robots]'"]) + "\n"
