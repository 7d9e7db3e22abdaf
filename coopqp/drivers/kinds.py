"""The kinds of drivers by name, as cell files give them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from coopqp.drivers.driver import RobotDriver
from coopqp.drivers.franka import FrankaDriver, FrankaOptions
from coopqp.drivers.ros2 import Ros2Driver, Ros2Options
from coopqp.drivers.sim import SimDriver, SimOptions
from coopqp.drivers.ur import UrDriver, UrOptions
from coopqp.spatial import Array


@dataclass(frozen=True)
class DriverKind:
    """A kind of drivers.

    Attributes:
        options: dataclass of its settings.
        make: a driver of joint names, start positions (n,) [rad or m], and settings.
        one_arm: it drives one arm alone, no joints that arms share.
    """

    options: type
    make: Callable[[Sequence[str], Array, Any], RobotDriver]
    one_arm: bool = False


DRIVER_KINDS: Mapping[str, DriverKind] = {
    "sim": DriverKind(SimOptions, SimDriver),
    "franka": DriverKind(FrankaOptions, lambda joints, q, options: FrankaDriver(joints, options), True),
    "ros2": DriverKind(Ros2Options, lambda joints, q, options: Ros2Driver(joints, options)),
    "ur": DriverKind(UrOptions, lambda joints, q, options: UrDriver(joints, options), True),
}
#: What ``--driver`` takes for every robot: their settings have defaults. The engine has all arms at a time.
FOR_EVERY_ARM = ("sim", "engine")
