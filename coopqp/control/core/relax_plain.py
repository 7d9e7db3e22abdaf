"""The relaxation of forces, one step of it, in NumPy, as in ``relax.c``. See :mod:`coopqp.forces.relaxation`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coopqp.checks import ArrayLike
from coopqp.control.core import layout
from coopqp.spatial import Array

#: Index of each scalar in the memory of the relaxation.
AT = {name: i for i, name in enumerate(layout.MINDING)}
HEARD, MISSED, SILENT = range(len(layout.HEARING))
CHECKING, PRESSING, RELAXING, MOVING = range(len(layout.STAGES))
SENSORS_FINE, SENSOR_SILENT, SENSOR_WRONG = range(len(layout.SENSORS))
_TURN_LENGTH = layout.CONSTANTS["TURN_LENGTH"]


def minding_views(memory: Array, arms: int) -> dict[str, Array]:
    """The parts of the memory behind its scalars, by name; ``palms``: see :mod:`coopqp.control.core.allow_plain`."""
    n, views, at = 6 * arms, {}, len(layout.MINDING)
    shapes: tuple[tuple[str, tuple[int, ...]], ...] = (
        ("silent", (arms,)), ("seen", (arms, 6)), ("internal", (arms, 6)), ("shift", (arms, 6)), ("drift", (arms, 6)),
        ("target", (arms, 6)), ("squeezed", (arms, 6)),
        ("internal_of", (n, n)), ("yields", (n, n)), ("palms", (arms, 2, 4, 6)),
    )  # fmt: skip
    for name, shape in shapes:
        size = math.prod(shape)
        views[name] = memory[at : at + size].reshape(shape)
        at += size
    return views


def minding_size(arms: int) -> int:
    """Size of the memory for a number of arms."""
    return len(layout.MINDING) + (37 + 48) * arms + 72 * arms**2


def gives_way(memory: Array) -> bool:
    """The grasps give way in this step, unless a sensor is silent for too long."""
    m = memory
    return bool(m[AT["STEPPED"]] and m[AT["STAGE"]] >= RELAXING and m[AT["SENSOR_FAULT"]] == SENSORS_FINE)


def relax(memory: Array, arms: int, wrenches: ArrayLike | None, dt: float, /) -> int:
    """Take wrenches (N, 6), and move the grasps where they give way; returns HEARD, MISSED or SILENT."""
    m, x, gives = memory, minding_views(memory, arms), gives_way(memory)
    heard = _feel(m, x, wrenches, dt)
    m[AT["AGE"]] += dt
    if heard == SILENT:
        if m[AT["SENSOR_FAULT"]] == SENSORS_FINE:
            most = int(x["silent"].argmax())
            m[AT["SENSOR_FAULT"]], m[AT["SENSOR_ARM"]], m[AT["SENSOR_AMOUNT"]] = SENSOR_SILENT, most, x["silent"][most]
        return heard
    if gives:
        _give_way(m, x, dt, m.item(AT["LAST_RATE"]) if m[AT["STAGE"]] == MOVING else 0.0)
    if m[AT["STAGE"]] == RELAXING and m[AT["SENSOR_FAULT"]] == SENSORS_FINE:
        _wait_at_rest(m, dt)
    return heard


def _feel(m: Array, x: dict[str, Array], wrenches: ArrayLike | None, dt: float) -> int:
    w = np.full_like(x["seen"], np.nan) if wrenches is None else np.asarray(wrenches, dtype=float)
    fresh = np.isfinite(w).all(axis=1)
    x["silent"][:] = np.where(fresh, 0.0, x["silent"] + dt)
    x["seen"][:] = np.where(fresh[:, None], w, x["seen"])
    now = (x["internal_of"] @ x["seen"].ravel()).reshape(-1, 6) - x["target"]
    x["internal"] += dt / (dt + m[AT["WRENCH_FILTER"]]) * (now - x["internal"])
    m[AT["SIZE"]] = _largest(x["internal"], 1.0, _TURN_LENGTH)
    if (x["silent"] > m[AT["WRENCH_SILENCE"]]).any():
        return SILENT
    return HEARD if fresh.all() else MISSED


def _give_way(m: Array, x: dict[str, Array], dt: float, rate: float) -> None:
    o: dict[str, Any] = {name: m.item(i) for name, i in AT.items()}
    size, way = o["SIZE"], np.zeros_like(x["shift"])
    if size > o["DEAD_BAND"]:
        yields = (x["yields"] @ x["internal"].ravel()).reshape(-1, 6)
        way = (o["DEAD_BAND"] / size - 1.0) / (o["STIFFER"] * o["RELAX_TIME"]) * yields
        x["drift"] += rate * dt / o["DRIFT_TIME"] * way
    way = way + rate * x["drift"]
    fastest = max(
        float(np.abs(way[:, :3]).max()) / o["MOST_SPEED"], float(np.abs(way[:, 3:]).max()) / o["MOST_SPIN"], 1.0
    )
    ease = m[AT["RELAX_EASE"]] = min(o["RELAX_EASE"] + dt / o["RAMP_TIME"], 1.0)
    moved = x["shift"] + (dt * ease / fastest) * way
    far = _largest(moved, o["MOST_REACH"], o["MOST_TURN"])
    m[AT["SATURATED"]] = far >= 1.0
    x["shift"][:] = moved / far if far > 1.0 else moved


def _wait_at_rest(m: Array, dt: float) -> None:
    """Palms press, and all forces are small, for long enough: then the object moves."""
    since, size = AT["SINCE"], m[AT["SIZE"]]
    m[since] = 0.0 if size > m[AT["PRESSED_BELOW"]] else m[since] + dt
    if m[since] > m[AT["WAIT"]] and size < m[AT["MOVE_BELOW"]]:
        m[AT["STAGE"]], m[since] = MOVING, 0.0


def _largest(rows: Array, linear: float, angular: float) -> float:
    """The largest norm of a force or way over ``linear``, or of a torque or turn over ``angular``."""
    squares = (rows * rows).reshape(-1, 2, 3).sum(axis=2).max(axis=0)
    return max(math.sqrt(squares[0]) / linear, math.sqrt(squares[1]) / angular)
