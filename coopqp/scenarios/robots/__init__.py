"""Robot descriptions that come with coopqp: URDF files of primitive shapes, without meshes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from coopqp.errors import UnknownNameError

__all__ = ["ROBOT_NAMES", "SEVERAL_ARMS", "robot_path"]

#: Robots with several arms, and their tool frames by the name of the arm; for :class:`coopqp.Robot`.
SEVERAL_ARMS: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {name: MappingProxyType({"left": "left_tool", "right": "right_tool"}) for name in ("lift2", "rail2")}
)
#: The robots with one arm, by the stem of their file: `rx90l` is the Stäubli RX-90L, `kr16_2` the KUKA KR 16-2,
#: `irb1600` the ABB IRB 1600-6/1.2; the others are made up.
ROBOT_NAMES: Final[tuple[str, ...]] = tuple(
    sorted(file.stem for file in Path(__file__).parent.glob("*.urdf") if file.stem not in SEVERAL_ARMS)
)


def robot_path(name: str) -> Path:
    """Return the path of the URDF of the robot `name`, one of `ROBOT_NAMES` or `SEVERAL_ARMS`.

    The end-effector frame is `flange` for the robots of manufacturers and `tool` for those that are made up.
    """
    if name not in ROBOT_NAMES and name not in SEVERAL_ARMS:
        raise UnknownNameError("robot", name, (*ROBOT_NAMES, *SEVERAL_ARMS), "coopqp.scenarios.robots")
    return Path(__file__).parent / f"{name}.urdf"
