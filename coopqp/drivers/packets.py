"""Packets between the driver ``sim`` and its robot: numbers in a fixed order, and the robot's settings as JSON."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from coopqp.drivers.driver import Condition, RobotState
from coopqp.spatial import Array

STATE, COMMAND, ORDER = b"S", b"C", b"O"
_CONDITIONS = tuple(Condition)
_HEAD = struct.Struct("<cdB")


def pack_state(stamp: float, condition: Condition, q: Array, velocity: Array, target: Array | None) -> bytes:
    """A state as a packet."""
    rows = [q, velocity] if target is None else [q, velocity, target]
    return _HEAD.pack(STATE, stamp, _CONDITIONS.index(condition)) + np.concatenate(rows).astype("<f8").tobytes()


def unpack_state(packet: bytes, joints: int) -> RobotState | None:
    """The state in a packet; None if it is none."""
    numbers = np.frombuffer(packet, "<f8", offset=_HEAD.size) if (len(packet) - _HEAD.size) % 8 == 0 else np.zeros(0)
    if packet[:1] != STATE or len(numbers) not in (2 * joints, 3 * joints):
        return None
    _, stamp, condition = _HEAD.unpack_from(packet)
    rows = numbers.reshape(-1, joints).astype(float)
    target = rows[2] if len(rows) == 3 else None
    return RobotState(rows[0], rows[1], stamp, target=target, condition=_CONDITIONS[condition])


def pack_command(at: float, q: Array) -> bytes:
    """A command as a packet."""
    return _HEAD.pack(COMMAND, at, 0) + q.astype("<f8").tobytes()


def unpack_command(packet: bytes) -> tuple[float, Array]:
    """Time and positions of a command."""
    return _HEAD.unpack_from(packet)[1], np.frombuffer(packet, "<f8", offset=_HEAD.size).astype(float)


def pack_order(name: str, **values: Any) -> bytes:
    """An order to the simulated robot: stop, release, another speed."""
    return ORDER + json.dumps({"order": name, **values}).encode()


def unpack_order(packet: bytes) -> dict[str, Any]:
    """The order in a packet."""
    order: dict[str, Any] = json.loads(packet[1:])
    return order
