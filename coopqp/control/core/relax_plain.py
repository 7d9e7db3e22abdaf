"""The relaxation of forces, one step of it, in NumPy: what ``relax.c`` does. See :mod:`coopqp.forces.relaxation`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coopqp.checks import ArrayLike
from coopqp.control.core import layout
from coopqp.spatial import Array

_AT = {name: i for i, name in enumerate(layout.RELAX)}
HEARD, MISSED, SILENT = range(len(layout.HEARING))
_TURN_LENGTH = layout.CONSTANTS["TURN_LENGTH"]


def relax_views(memory: Array, arms: int) -> dict[str, Array]:
    """The parts of the memory behind its scalars, by name."""
    n, views, at = 6 * arms, {}, len(layout.RELAX)
    shapes: tuple[tuple[str, tuple[int, ...]], ...] = (
        ("silent", (arms,)), ("seen", (arms, 6)), ("internal", (arms, 6)), ("shift", (arms, 6)), ("drift", (arms, 6)),
        ("target", (arms, 6)),
        ("internal_of", (n, n)), ("yields", (n, n)),
    )  # fmt: skip
    for name, shape in shapes:
        size = math.prod(shape)
        views[name] = memory[at : at + size].reshape(shape)
        at += size
    return views


def relax_size(arms: int) -> int:
    """Numbers of the memory of so many arms."""
    return len(layout.RELAX) + arms + 30 * arms + 72 * arms**2


def relax(memory: Array, arms: int, wrenches: ArrayLike | None, dt: float, rate: float, gives: bool, /) -> int:
    """Take wrenches (N, 6); then move the grasps if ``gives``, unless a sensor has been silent for too long."""
    m, x = memory, relax_views(memory, arms)
    w = np.full((arms, 6), np.nan) if wrenches is None else np.asarray(wrenches, dtype=float)
    fresh = np.isfinite(w).all(axis=1)
    x["silent"][:] = np.where(fresh, 0.0, x["silent"] + dt)
    x["seen"][:] = np.where(fresh[:, None], w, x["seen"])
    now = (x["internal_of"] @ x["seen"].ravel()).reshape(-1, 6) - x["target"]
    x["internal"] += dt / (dt + m[_AT["WRENCH_FILTER"]]) * (now - x["internal"])
    m[_AT["SIZE"]] = _largest(x["internal"], 1.0, _TURN_LENGTH)
    if (x["silent"] > m[_AT["WRENCH_SILENCE"]]).any():
        return SILENT
    if gives:
        _give_way(m, x, dt, rate)
    return HEARD if fresh.all() else MISSED


def _give_way(m: Array, x: dict[str, Array], dt: float, rate: float) -> None:
    o: dict[str, Any] = {name: m.item(i) for name, i in _AT.items()}
    size, way = o["SIZE"], np.zeros_like(x["shift"])
    if size > o["DEAD_BAND"]:
        yields = (x["yields"] @ x["internal"].ravel()).reshape(-1, 6)
        way = (o["DEAD_BAND"] / size - 1.0) / (o["STIFFER"] * o["RELAX_TIME"]) * yields
        x["drift"] += rate * dt / o["DRIFT_TIME"] * way
    way = way + rate * x["drift"]
    fastest = max(
        float(np.abs(way[:, :3]).max()) / o["MOST_SPEED"], float(np.abs(way[:, 3:]).max()) / o["MOST_SPIN"], 1.0
    )
    ease = m[_AT["RELAX_EASE"]] = min(o["RELAX_EASE"] + dt / o["RAMP_TIME"], 1.0)
    moved = x["shift"] + (dt * ease / fastest) * way
    far = _largest(moved, o["MOST_REACH"], o["MOST_TURN"])
    m[_AT["SATURATED"]] = far >= 1.0
    x["shift"][:] = moved / far if far > 1.0 else moved


def _largest(rows: Array, linear: float, angular: float) -> float:
    """The largest norm of a force or way over ``linear``, or of a torque or turn over ``angular``."""
    squares = (rows * rows).reshape(-1, 2, 3).sum(axis=2).max(axis=0)
    return max(math.sqrt(squares[0]) / linear, math.sqrt(squares[1]) / angular)
