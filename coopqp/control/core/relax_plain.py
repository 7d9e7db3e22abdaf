"""The relaxation of forces, one step of it, in NumPy, as in ``relax.cpp``. See :mod:`coopqp.forces.admittance`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coopqp.checks import ArrayLike
from coopqp.native import layout
from coopqp.native.constants import (
    CAREFUL_START,
    CONTACT_BACK,
    CONTACT_FILTER,
    CONTACT_LASTS,
    CONTACT_ROOM,
    CONTACT_SETTLES,
    CONTACT_WAY,
    CORRECTION_FADES,
    HEAD_ON,
    LATE_LOAD,
    LET_GO,
    MORE_THAN_AT_START,
    MORE_THAN_INTERNAL,
    MORE_THAN_STOPPED,
    PUSHED_FOR,
    PUSHES_FADE,
    SENSED_MOTION,
    SERVO_PEAK,
    SLOWEST_LESSON,
    SOFTEST,
    STRANGE_SERVOS,
    TURN_LENGTH,
    UNTIL_TOLD,
)
from coopqp.spatial import Array

#: Index of each scalar in the memory of the relaxation.
AT = {name: i for i, name in enumerate(layout.MINDING)}
HEARD, MISSED, SILENT = range(len(layout.HEARING))
CHECKING, PRESSING, RELAXING, MOVING = range(len(layout.STAGES))
SENSORS_FINE, SENSOR_SILENT, SENSOR_WRONG = range(len(layout.SENSORS))


def minding_views(memory: Array, arms: int) -> dict[str, Array]:
    """The parts of the memory behind its scalars, by name; ``palms``: see :mod:`coopqp.control.core.allow_plain`."""
    n, views, at = 6 * arms, {}, len(layout.MINDING)
    shapes: tuple[tuple[str, tuple[int, ...]], ...] = (
        ("silent", (arms,)), ("seen", (arms, 6)), ("internal", (arms, 6)), ("shift", (arms, 6)), ("drift", (arms, 6)),
        ("target", (arms, 6)), ("squeezed", (arms, 6)),
        ("internal_of", (n, n)), ("yields", (n, n)), ("palms", (arms, 2, 4, 6)),
        ("felt", (arms, 6)), ("held", (arms, 6)), ("off_servos", (arms, 6)), ("off_last", (arms, 6)),
        ("off_step", (arms, 6)), ("off_drift", (arms, 6)), ("off_noise", (arms,)),
        ("compliances", (arms, 6, 6)), ("carries", (n, 3)), ("unfed_of", (n, n)),
        ("reference", (12,)), ("centre", (3,)), ("travel", (3, 3)), ("push", (5, 3)),
    )  # fmt: skip
    for name, shape in shapes:
        size = math.prod(shape)
        views[name] = memory[at : at + size].reshape(shape)
        at += size
    return views


def minding_size(arms: int) -> int:
    """Size of the memory for a number of arms."""
    return len(layout.MINDING) + 39 + (128 + 48) * arms + 108 * arms**2


def gives_way(memory: Array) -> bool:
    """The grasps give way in this step, unless a sensor is silent for too long."""
    m = memory
    return bool(m[AT["STEPPED"]] and m[AT["STAGE"]] >= RELAXING and m[AT["SENSOR_FAULT"]] == SENSORS_FINE)


def squeezes(memory: Array) -> bool:
    """The arms squeeze the object while they relax, more than at the start: what should relax them pulls."""
    m = memory
    if m[AT["STAGE"]] != RELAXING or m[AT["HAS_PALMS"]]:
        return False
    return bool(m[AT["SIZE"]] >= m[AT["FORCE_HOLDS"]] and m[AT["SIZE"]] > MORE_THAN_AT_START * m[AT["START_SIZE"]])


def relax(memory: Array, arms: int, wrenches: ArrayLike | None, dt: float, /) -> int:
    """Take wrenches (N, 6), and move the grasps where they give way; returns HEARD, MISSED or SILENT."""
    m, x, gives = memory, minding_views(memory, arms), gives_way(memory)
    heard = _feel(m, x, wrenches, dt)
    m[AT["AGE"]] += dt
    if m[AT["STAGE"]] == MOVING:  # the object is led to its path once the arms have relaxed
        m[AT["CORRECTS"]] = min(m[AT["CORRECTS"]] + dt / CORRECTION_FADES, 1.0)
    if heard == SILENT:
        if m[AT["SENSOR_FAULT"]] == SENSORS_FINE:
            most = int(x["silent"].argmax())
            m[AT["SENSOR_FAULT"]], m[AT["SENSOR_ARM"]], m[AT["SENSOR_AMOUNT"]] = SENSOR_SILENT, most, x["silent"][most]
        return heard
    _find_contact(m, x, dt)
    if m[AT["STAGE"]] < RELAXING:  # an object that grows squeezes by itself
        m[AT["START_SIZE"]] = max(m[AT["START_SIZE"]], m[AT["SIZE"]])
    if gives and m[AT["BACKS"]] == 0.0:  # what pushes the object also pushes the arms against each other
        _give_way(m, x, dt, m.item(AT["LAST_RATE"]) if m[AT["STAGE"]] == MOVING else 0.0)
    if m[AT["STAGE"]] == RELAXING and m[AT["SENSOR_FAULT"]] == SENSORS_FINE:
        _wait_at_rest(m, dt)
    return heard


def _feel(m: Array, x: dict[str, Array], wrenches: ArrayLike | None, dt: float) -> int:
    w = np.full_like(x["seen"], np.nan) if wrenches is None else np.asarray(wrenches, dtype=float)
    fresh = np.isfinite(w).all(axis=1)
    same = (w == x["seen"]).all(axis=1) & (m[AT["LAST_SPEED"]] > SENSED_MOTION)  # while the arms move
    x["silent"][:] = np.where(fresh & ~same, 0.0, x["silent"] + dt)
    x["seen"][:] = np.where(fresh[:, None], w, x["seen"])
    now = (x["internal_of"] @ x["seen"].ravel()).reshape(-1, 6) - x["target"]
    m[AT["SHARPEST"]] = np.linalg.norm(now[:, :3], axis=1).max()
    share = dt / (dt + m[AT["WRENCH_FILTER"]])
    x["internal"] += share * (now - x["internal"])
    x["felt"] += share * (x["seen"] - x["felt"])
    m[AT["SIZE"]] = _largest(x["internal"], 1.0, TURN_LENGTH)
    if (x["silent"] > m[AT["WRENCH_SILENCE"]]).any():
        return SILENT
    return HEARD if fresh.all() else MISSED


def _find_contact(m: Array, x: dict[str, Array], dt: float) -> None:
    """What pushes the object, beside its weight and the arms: the sum of their wrenches, less its weight and inertia.

    What was there before it moved is no contact, nor any less of it: a payload of another mass than told, or a table
    that it is lifted from.
    """
    if not m[AT["CONTACT_LIMIT"]] < math.inf:
        return
    R, travel, moves = x["reference"][:9].reshape(3, 3), x["travel"], m[AT["STAGE"]] >= MOVING
    push, base, last, back, impulse = x["push"]
    place, since, haste = R @ x["centre"] + x["reference"][9:], max(m.item(AT["REFERENCE_DT"]), 1e-6), AT["LOAD_HASTE"]
    if moves:
        velocity = (place - travel[0]) / since
        change = (velocity - travel[1]) / since
        travel[:2] = place, velocity
        travel[2] += dt / (dt + m[AT["WRENCH_FILTER"]]) * (change - travel[2])
        m[haste] = max(float(np.linalg.norm(change)), m[haste] * SERVO_PEAK / (SERVO_PEAK + dt))
        m[AT["LOAD_SPEED"]] = max(
            math.sqrt(velocity @ velocity), m[AT["LOAD_SPEED"]] * PUSHES_FADE / (PUSHES_FADE + dt)
        )
    else:
        travel[0], travel[1:], m[haste] = place, 0.0, 0.0
    n = len(x["seen"])
    felt = np.einsum("kikj,kj->i", x["unfed_of"].reshape(n, 6, n, 6)[:, :3], x["seen"])
    now = m[AT["WEIGHT_X"] : AT["WEIGHT_Z"] + 1] + m[AT["LOAD_MASS"]] * travel[2] - R @ felt
    push += dt / (dt + CONTACT_FILTER) * (now - push)
    if not moves:
        base += dt / (dt + CONTACT_SETTLES) * (now - base)
        return
    off = push - min(max(push @ base / max(base @ base, 1e-12), 0.0), 1.0) * base
    m[AT["PUSHED"]] = math.sqrt(off @ off)
    limit = (LET_GO if m[AT["TOUCHES"]] else 1.0) * m[AT["CONTACT_LIMIT"]]
    clear = m[AT["TOUCHES"]] or (not m[AT["SUSPECTED"]] and m[AT["PUSHED"]] > MORE_THAN_INTERNAL * m[AT["SHARPEST"]])
    impulse *= PUSHES_FADE / (PUSHES_FADE + dt)
    if m[AT["PUSHED"]] >= m[AT["CONTACT_LIMIT"]]:
        impulse += dt * off
    stops = MORE_THAN_STOPPED * m[AT["LOAD_MASS"]] * m[AT["LOAD_SPEED"]] + PUSHED_FOR * m[AT["CONTACT_LIMIT"]]
    if (clear or impulse @ impulse > stops * stops) and m[AT["PUSHED"]] - LATE_LOAD * m[AT["LOAD_MASS"]] * m[
        haste
    ] >= limit:
        if m[AT["TOUCHES"]] <= UNTIL_TOLD:
            _turn_back(m, travel[1], off, back)
            last[:] = 0.0
        if off @ off > last @ last:
            last[:] = off
        m[AT["TOUCHES"]] = CONTACT_LASTS
    elif m[AT["TOUCHES"]]:
        m[AT["TOUCHES"]] = max(m[AT["TOUCHES"]] - dt, 0.0 if m[AT["GOES_ON"]] else UNTIL_TOLD)
    m[AT["BACKS"]] = 0.0
    if m[AT["TOUCHES"]]:
        m[AT["CORRECTS"]] = m[AT["FORCE_CAP"]] = 0.0
        _go_back(m, off, back, dt)


def _turn_back(m: Array, velocity: Array, off: Array, back: Array) -> None:
    """An object that has met something goes back the way that it came, which is free; or else the way it is pushed.

    As fast as it came, at first as far as it went before that was known.
    """
    speed, size = math.sqrt(velocity @ velocity), math.sqrt(off @ off)
    against = -(velocity @ off) >= HEAD_ON * speed * size and speed > 0.0
    back[:] = velocity / -speed if against else off / max(size, 1e-12)
    m[AT["BACK_SPEED"]] = max(speed, CONTACT_BACK)
    m[AT["BACK_OWED"]], m[AT["BACK_FROM"]], m[AT["GOES_ON"]] = speed * m[AT["CONTACT_LATE"]], math.nan, 0.0


def _go_back(m: Array, off: Array, back: Array, dt: float) -> None:
    """BACKS, the speed at which the object goes back now: until nothing pushes it any more."""
    most = m[AT["BACK_SPEED"]] * dt
    if back @ off >= LET_GO * m[AT["CONTACT_LIMIT"]]:
        m[AT["BACK_OWED"]] = max(m[AT["BACK_OWED"]], most)
    way = min(m[AT["BACK_OWED"]], most)
    m[AT["BACK_OWED"]] -= way
    m[AT["BACKS"]] = way / dt


def back_within_room(memory: Array, far: float, dt: float) -> float:
    """The speed at which an object goes back that is ``far`` from its path in that direction [m], in limited room."""
    m, begin = memory, AT["BACK_FROM"]
    if math.isnan(m[begin]):
        m[begin] = far
    room = CONTACT_ROOM + CONTACT_WAY * m.item(AT["BACK_SPEED"]) - (far - m.item(begin))
    return min(m.item(AT["BACKS"]), max(room, 0.0) / dt)


def _give_way(m: Array, x: dict[str, Array], dt: float, rate: float) -> None:
    o: dict[str, Any] = {name: m.item(i) for name, i in AT.items()}
    size, soft, way = o["SIZE"], min(max(o["STIFFER"], SOFTEST), 1.0), np.zeros_like(x["shift"])
    asks = min(rate, o["ALLOWED"]) if o["AT_END"] else rate  # past its end a step says 1 again, however slow it came
    if size > o["DEAD_BAND"]:
        yields = (x["yields"] @ x["internal"].ravel()).reshape(-1, 6)
        way = (o["DEAD_BAND"] / size - 1.0) / (max(o["STIFFER"], 1.0) * o["RELAX_TIME"]) * yields
        # Softer servos than given are answered more slowly, and their drift is learned as much more slowly.
        # A slow object shows little of its drift, which would be learned with the square of the rate.
        counts = min(max(rate, SLOWEST_LESSON), 1.0)
        x["drift"] += rate * dt * soft / (counts * counts * o["DRIFT_TIME"]) * way
    if o["AT_END"]:  # soft servos, and slow objects, would unlearn slowly what the path has asked for
        x["drift"] *= 1.0 - rate * dt * (1.0 - soft * asks) / (o["DRIFT_TIME"] + dt)
    way = way + asks * x["drift"]
    fastest = max(
        float(np.abs(way[:, :3]).max()) / o["MOST_SPEED"], float(np.abs(way[:, 3:]).max()) / o["MOST_SPIN"], 1.0
    )
    ease = m[AT["RELAX_EASE"]] = min(o["RELAX_EASE"] + dt / o["RAMP_TIME"], 1.0)
    moved = x["shift"] + (dt * ease / fastest) * way
    far = _largest(moved, o["MOST_REACH"], o["MOST_TURN"])
    m[AT["SATURATED"]] = far >= 1.0
    x["shift"][:] = moved / far if far > 1.0 else moved


def _wait_at_rest(m: Array, dt: float) -> None:
    """Palms press, and all forces are small, for long enough: then the object moves.

    It moves slowly at first on servos that were found to be other ones than told.
    """
    since, size = AT["SINCE"], m[AT["SIZE"]]
    m[since] = 0.0 if size > m[AT["PRESSED_BELOW"]] else m[since] + dt
    if m[since] > m[AT["WAIT"]] and size < m[AT["MOVE_BELOW"]]:
        m[AT["STAGE"]], m[since] = MOVING, 0.0
        stiffer = m[AT["STIFFER"]]
        softer = stiffer > SOFTEST and stiffer * STRANGE_SERVOS < 1.0  # or they do not answer at all
        if not m[AT["HAS_PALMS"]] and (softer or stiffer > STRANGE_SERVOS):  # the pads of palms yield, too
            m[AT["FORCE_CAP"]] = min(m[AT["FORCE_CAP"]], CAREFUL_START)


def _largest(rows: Array, linear: float, angular: float) -> float:
    """The largest norm of a force or way over ``linear``, or of a torque or turn over ``angular``."""
    squares = (rows * rows).reshape(-1, 2, 3).sum(axis=2).max(axis=0)
    return max(math.sqrt(squares[0]) / linear, math.sqrt(squares[1]) / angular)
