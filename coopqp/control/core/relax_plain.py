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
    TURN_LENGTH,
    UNTIL_TOLD,
)
from coopqp.spatial import Array

HEARD, MISSED, SILENT = range(len(layout.HEARING))
CHECKING, PRESSING, RELAXING, MOVING = range(len(layout.STAGES))
SENSORS_FINE, SENSOR_SILENT, SENSOR_WRONG = range(len(layout.SENSORS))


def minding_scalars(memory: Array) -> Any:
    """The scalars of the memory, by name."""
    return layout.Minding.from_buffer(memory)


def minding_views(memory: Array, arms: int) -> dict[str, Array]:
    """The parts of the memory behind its scalars, by name; ``palms``: see :mod:`coopqp.control.core.allow_plain`."""
    n, views, at = 6 * arms, {}, layout.SIZES["Minding"]
    shapes: tuple[tuple[str, tuple[int, ...]], ...] = (
        ("silent", (arms,)), ("seen", (arms, 6)), ("internal", (arms, 6)), ("shift", (arms, 6)), ("drift", (arms, 6)),
        ("target", (arms, 6)), ("squeezed", (arms, 6)),
        ("internal_of", (n, n)), ("yields", (n, n)), ("palms", (arms, 2, 4, 6)),
        ("felt", (arms, 6)), ("held", (arms, 6)), ("off_servos", (arms, 6)), ("off_last", (arms, 6)),
        ("off_step", (arms, 6)), ("off_drift", (arms, 6)), ("off_noise", (arms,)),
        ("holding", (arms,)), ("freed", (arms,)), ("compliances", (arms, 6, arms, 6)), ("carries", (n, 3)),
        ("unfed_of", (n, n)), ("reference", (12,)), ("centre", (3,)), ("travel", (3, 3)), ("push", (5, 3)),
    )  # fmt: skip
    for name, shape in shapes:
        size = math.prod(shape)
        views[name] = memory[at : at + size].reshape(shape)
        at += size
    return views


def minding_size(arms: int) -> int:
    """Size of the memory for a number of arms."""
    return layout.SIZES["Minding"] + 39 + (94 + 48) * arms + 144 * arms**2


def gives_way(m: Any) -> bool:
    """The grasps give way in this step, unless a sensor is silent for too long."""
    return bool(m.stepped and m.stage >= RELAXING and m.sensor_fault == SENSORS_FINE)


def squeezes(m: Any) -> bool:
    """The arms squeeze the object while they relax, more than at the start: what should relax them pulls."""
    if m.stage != RELAXING or m.has_palms:
        return False
    return bool(m.size >= m.force_holds and m.size > MORE_THAN_AT_START * m.start_size)


def relax(memory: Array, arms: int, wrenches: ArrayLike | None, dt: float, /) -> int:
    """Take wrenches (N, 6), and move the grasps where they give way; returns HEARD, MISSED or SILENT."""
    m, x = minding_scalars(memory), minding_views(memory, arms)
    gives = gives_way(m)
    heard = _feel(m, x, wrenches, dt)
    m.age += dt
    if m.stage == MOVING:  # the object is led to its path once the arms have relaxed
        m.corrects = min(m.corrects + dt / CORRECTION_FADES, 1.0)
    if heard == SILENT:
        if m.sensor_fault == SENSORS_FINE:
            most = int(x["silent"].argmax())
            m.sensor_fault, m.sensor_arm, m.sensor_amount = SENSOR_SILENT, most, x["silent"][most]
        return heard
    _find_contact(m, x, dt)
    if m.stage < RELAXING:  # an object that grows squeezes by itself
        m.start_size = max(m.start_size, m.size)
    if gives and m.backs == 0.0:  # what pushes the object also pushes the arms against each other
        _give_way(m, x, dt, m.last_rate if m.stage == MOVING else 0.0)
    _come_back(m, x, dt)
    if m.stage == RELAXING and m.sensor_fault == SENSORS_FINE:
        _wait_at_rest(m, dt)
    return heard


def _feel(m: Any, x: dict[str, Array], wrenches: ArrayLike | None, dt: float) -> int:
    w = np.full_like(x["seen"], np.nan) if wrenches is None else np.array(wrenches, dtype=float)
    holds = x["holding"].astype(bool)
    w[~holds] = 0.0  # its sensor reads its tool alone
    fresh = np.isfinite(w).all(axis=1)
    same = (w == x["seen"]).all(axis=1) & (m.last_speed > SENSED_MOTION) & holds  # while the arms move
    x["silent"][:] = np.where(fresh & ~same, 0.0, x["silent"] + dt)
    x["seen"][:] = np.where(fresh[:, None], w, x["seen"])
    now = (x["internal_of"] @ x["seen"].ravel()).reshape(-1, 6) - x["target"]
    m.sharpest = np.linalg.norm(now[:, :3], axis=1).max()
    share = dt / (dt + m.wrench_filter)
    x["internal"] += share * (now - x["internal"])
    x["felt"] += share * (x["seen"] - x["felt"])
    m.size = _largest(x["internal"], 1.0, TURN_LENGTH)
    if (x["silent"] > m.wrench_silence).any():
        return SILENT
    return HEARD if fresh.all() else MISSED


def _find_contact(m: Any, x: dict[str, Array], dt: float) -> None:
    """What pushes the object, beside its weight and the arms: the sum of their wrenches, less its weight and inertia.

    What was there before it moved is no contact, nor any less of it: a payload of another mass than told, or a table
    that it is lifted from.
    """
    if not m.contact_limit < math.inf:
        return
    R, travel, moves = x["reference"][:9].reshape(3, 3), x["travel"], m.stage >= MOVING
    push, base, last, back, impulse = x["push"]
    place, since = R @ x["centre"] + x["reference"][9:], max(m.reference_dt, 1e-6)
    if moves:
        velocity = (place - travel[0]) / since
        change = (velocity - travel[1]) / since
        travel[:2] = place, velocity
        travel[2] += dt / (dt + m.wrench_filter) * (change - travel[2])
        m.load_haste = max(float(np.linalg.norm(change)), m.load_haste * SERVO_PEAK / (SERVO_PEAK + dt))
        m.load_speed = max(math.sqrt(velocity @ velocity), m.load_speed * PUSHES_FADE / (PUSHES_FADE + dt))
    else:
        travel[0], travel[1:], m.load_haste = place, 0.0, 0.0
    n = len(x["seen"])
    felt = np.einsum("kikj,kj->i", x["unfed_of"].reshape(n, 6, n, 6)[:, :3], x["seen"])
    now = np.array([m.weight_x, m.weight_y, m.weight_z]) + m.load_mass * travel[2] - R @ felt
    push += dt / (dt + CONTACT_FILTER) * (now - push)
    if not moves:
        base += dt / (dt + CONTACT_SETTLES) * (now - base)
        return
    off = push - min(max(push @ base / max(base @ base, 1e-12), 0.0), 1.0) * base
    m.pushed = math.sqrt(off @ off)
    limit = (LET_GO if m.touches else 1.0) * m.contact_limit
    clear = m.touches or (not m.suspected and m.pushed > MORE_THAN_INTERNAL * m.sharpest)
    impulse *= PUSHES_FADE / (PUSHES_FADE + dt)
    if m.pushed >= m.contact_limit:
        impulse += dt * off
    stops = MORE_THAN_STOPPED * m.load_mass * m.load_speed + PUSHED_FOR * m.contact_limit
    if (clear or impulse @ impulse > stops * stops) and m.pushed - LATE_LOAD * m.load_mass * m.load_haste >= limit:
        if m.touches <= UNTIL_TOLD:
            _turn_back(m, travel[1], off, back)
            last[:] = 0.0
        if off @ off > last @ last:
            last[:] = off
        m.touches = CONTACT_LASTS
    elif m.touches:
        m.touches = max(m.touches - dt, 0.0 if m.goes_on else UNTIL_TOLD)
    m.backs = 0.0
    if m.touches:
        m.corrects = m.force_cap = 0.0
        _go_back(m, off, back, dt)


def _turn_back(m: Any, velocity: Array, off: Array, back: Array) -> None:
    """An object that has met something goes back the way that it came, which is free; or else the way it is pushed.

    As fast as it came, at first as far as it went before that was known.
    """
    speed, size = math.sqrt(velocity @ velocity), math.sqrt(off @ off)
    against = -(velocity @ off) >= HEAD_ON * speed * size and speed > 0.0
    back[:] = velocity / -speed if against else off / max(size, 1e-12)
    m.back_speed = max(speed, CONTACT_BACK)
    m.back_owed, m.back_from, m.goes_on = speed * m.contact_late, math.nan, 0.0


def _go_back(m: Any, off: Array, back: Array, dt: float) -> None:
    """``backs``, the speed at which the object goes back now: until nothing pushes it any more."""
    most = m.back_speed * dt
    if back @ off >= LET_GO * m.contact_limit:
        m.back_owed = max(m.back_owed, most)
    way = min(m.back_owed, most)
    m.back_owed -= way
    m.backs = way / dt


def back_within_room(m: Any, far: float, dt: float) -> float:
    """The speed at which an object goes back that is ``far`` from its path in that direction [m], in limited room."""
    if math.isnan(m.back_from):
        m.back_from = far
    room = CONTACT_ROOM + CONTACT_WAY * m.back_speed - (far - m.back_from)
    return float(min(m.backs, max(room, 0.0) / dt))


def _give_way(m: Any, x: dict[str, Array], dt: float, rate: float) -> None:
    o = layout.Minding.from_buffer_copy(m)
    size, soft, way = o.size, min(max(o.stiffer, SOFTEST), 1.0), np.zeros_like(x["shift"])
    asks = min(rate, o.allowed)  # a step to the path's end says 1 again, however slow it came
    if size > o.dead_band:
        yields = (x["yields"] @ x["internal"].ravel()).reshape(-1, 6)
        way = (o.dead_band / size - 1.0) / (max(o.stiffer, 1.0) * o.relax_time) * yields
        # Softer servos than given are answered more slowly, and their drift is learned as much more slowly.
        # A slow object shows little of its drift, which would be learned with the square of the rate.
        counts = min(max(rate, SLOWEST_LESSON), 1.0)
        x["drift"] += rate * dt * soft / (counts * counts * o.drift_time) * way
    if o.at_end:  # soft servos, and slow objects, would unlearn slowly what the path has asked for
        x["drift"] *= 1.0 - rate * dt * (1.0 - soft * asks) / (o.drift_time + dt)
    way = way + asks * x["drift"]
    fastest = max(float(np.abs(way[:, :3]).max()) / o.most_speed, float(np.abs(way[:, 3:]).max()) / o.most_spin, 1.0)
    ease = m.relax_ease = min(o.relax_ease + dt / o.ramp_time, 1.0)
    moved = x["shift"] + (dt * ease / fastest) * way
    far = _largest(moved, o.most_reach, o.most_turn)
    m.saturated = far >= 1.0 - 1e-9  # also where it rests at the end of its reach, to rounding
    x["shift"][:] = moved / far if far > 1.0 else moved


def _come_back(m: Any, x: dict[str, Array], dt: float) -> None:
    """The grasp of an arm that has let go comes back to its place, slowly at first, while the arm is free.

    Its distance from where it held is forgotten as its servos spring back.
    """
    for k in np.flatnonzero(x["holding"] == 0.0):
        way = x["shift"][k] / m.relax_time
        fastest = max(float(np.abs(way[:3]).max()) / m.most_speed, float(np.abs(way[3:]).max()) / m.most_spin, 1.0)
        x["freed"][k] = min(x["freed"][k] + dt / m.ramp_time, 1.0)
        x["shift"][k] -= min(dt * x["freed"][k] / fastest, m.relax_time) * way
        x["held"][k] += dt / (dt + m.wrench_filter) * (x["shift"][k] - x["held"][k])


def _wait_at_rest(m: Any, dt: float) -> None:
    """Palms press, and all forces are small, for long enough: then the object moves.

    It moves slowly at first, so that forces of lags and bases are felt while they are small.
    """
    m.since = 0.0 if m.size > m.pressed_below else m.since + dt
    if m.since > m.wait and m.size < m.move_below:
        m.stage, m.since = MOVING, 0.0
        if not m.has_palms and m.stiffer > SOFTEST:  # pads of palms yield; the softest servos do not answer at all
            m.force_cap = min(m.force_cap, CAREFUL_START / math.sqrt(max(m.stiffer, 1.0 / m.stiffer)))


def _largest(rows: Array, linear: float, angular: float) -> float:
    """The largest norm of a force or way over ``linear``, or of a torque or turn over ``angular``."""
    squares = (rows * rows).reshape(-1, 2, 3).sum(axis=2).max(axis=0)
    return max(math.sqrt(squares[0]) / linear, math.sqrt(squares[1]) / angular)
