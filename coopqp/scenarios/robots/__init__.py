"""Robot descriptions that come with coopqp: URDF files of primitive shapes, without meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from coopqp.errors import UnknownNameError

__all__ = ["ROBOT_NAMES", "robot_path"]

#: The robots, by the stem of their file: `rx90l` is the Stäubli RX-90L, `kr16_2` the KUKA KR 16-2, `irb1600` the ABB
#: IRB 1600-6/1.2; the others are made up.
ROBOT_NAMES: Final[tuple[str, ...]] = tuple(sorted(file.stem for file in Path(__file__).parent.glob("*.urdf")))


def robot_path(name: str) -> Path:
    """Return the path of the URDF of the robot `name`, one of `ROBOT_NAMES`.

    The end-effector frame is `flange` for the robots of manufacturers and `tool` for those that are made up.
    """
    if name not in ROBOT_NAMES:
        raise UnknownNameError("robot", name, ROBOT_NAMES, "coopqp.scenarios.robots")
    return Path(__file__).parent / f"{name}.urdf"
