"""Packets between a driver and its robot's process: numbers in a fixed order, and orders and errors as JSON."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from coopqp.drivers.driver import Condition, RobotState
from coopqp.spatial import Array

STATE, COMMAND, ORDER, ERROR = b"S", b"C", b"O", b"E"
_CONDITIONS = tuple(Condition)
#: Kind, stamp, condition, what follows positions and velocities, scaling.
_HEAD = struct.Struct("<cdBBd")
_TARGET, _WRENCH = 1, 2


def pack_state(state: RobotState) -> bytes:
    """A state as a packet; its wrench is of one arm."""
    rows = [state.q, state.velocity]
    flags = 0
    for flag, more in ((_TARGET, state.target), (_WRENCH, state.wrench)):
        if more is not None:
            rows.append(np.asarray(more))
            flags |= flag
    head = _HEAD.pack(STATE, state.stamp, _CONDITIONS.index(state.condition), flags, state.scaling)
    return head + np.concatenate(rows).astype("<f8").tobytes()


def unpack_state(packet: bytes, joints: int) -> RobotState | None:
    """The state in a packet; None if it is none."""
    if packet[:1] != STATE or len(packet) < _HEAD.size:
        return None
    _, stamp, condition, flags, scaling = _HEAD.unpack_from(packet)
    sizes = [joints, joints, joints * bool(flags & _TARGET), 6 * bool(flags & _WRENCH)]
    if len(packet) != _HEAD.size + 8 * sum(sizes) or condition >= len(_CONDITIONS):
        return None
    numbers = np.frombuffer(packet, "<f8", offset=_HEAD.size).astype(float)
    q, velocity, target, wrench = np.split(numbers, np.cumsum(sizes)[:-1])
    return RobotState(
        q, velocity, stamp, target=target if sizes[2] else None, wrench=wrench if sizes[3] else None,
        scaling=scaling, condition=_CONDITIONS[condition],
    )  # fmt: skip


def pack_command(at: float, q: Array) -> bytes:
    """A command as a packet."""
    return _HEAD.pack(COMMAND, at, 0, 0, 0.0) + q.astype("<f8").tobytes()


def unpack_command(packet: bytes) -> tuple[float, Array]:
    """Time and positions of a command."""
    return _HEAD.unpack_from(packet)[1], np.frombuffer(packet, "<f8", offset=_HEAD.size).astype(float)


def pack_order(name: str, **values: Any) -> bytes:
    """An order to the robot's process: stop, release, another speed."""
    return ORDER + json.dumps({"order": name, **values}).encode()


def unpack_order(packet: bytes) -> dict[str, Any]:
    """The order in a packet."""
    order: dict[str, Any] = json.loads(packet[1:])
    return order


def pack_error(text: str) -> bytes:
    """Why a robot cannot be driven, as a packet."""
    return ERROR + text.encode()
