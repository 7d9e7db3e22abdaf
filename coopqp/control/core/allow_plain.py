"""The rate of the object that forces allow, in NumPy, as in ``allow.cpp``. See :mod:`coopqp.forces`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coopqp.control.core.relax_plain import MOVING, SENSORS_FINE, minding_scalars, minding_views
from coopqp.native import layout
from coopqp.native.constants import FIRMER, FRICTION_SLOWS, LEAST_CALM, RATE_FALLS, RATE_RISES, SLOW_RATE, SPARE_SQUEEZE
from coopqp.spatial import Array

NOTHING_MORE, BY_SENSOR, BY_REACH, BY_STAGE, BY_FRICTION, BY_FORCE, BY_CONTACT, BY_RELEASE = range(len(layout.WHYS))


def allow(memory: Array, arms: int, dt: float, /) -> None:
    """Find the largest rate of the object now, ``allowed``, and ``why`` it is less than the wanted rate."""
    m = minding_scalars(memory)
    size, slows, asked = m.size, m.force_slows, m.asked
    m.allowed, why = 0.0, NOTHING_MORE
    if m.sensor_fault != SENSORS_FINE:
        why = BY_SENSOR
    elif m.touches:
        why = BY_CONTACT
    elif m.saturated and size > slows:
        why = BY_REACH
    elif m.stage != MOVING:
        why = BY_STAGE
    m.why = why
    if why != NOTHING_MORE:
        return
    if m.has_palms and _friction_slows(m, minding_views(memory, arms), dt):
        m.why, m.allowed = BY_FRICTION, min(m.force_cap, asked)
        return
    holds = m.force_holds
    _ease_cap(m, min(max((holds - size) / (holds - slows), 0.0), 1.0), dt)
    cap = m.force_cap
    m.why, m.allowed = NOTHING_MORE if cap >= asked else BY_FORCE, min(cap, asked)


def _ease_cap(m: Any, cap: float, dt: float) -> None:
    """Let the rate that forces allow come closer to ``cap``.

    It falls in proportion to itself, as braking makes forces of its own, and rises the less, the more is felt, and the
    stiffer the servos are: there a force that is felt soon is a large one.
    """
    now, root = m.force_cap, math.sqrt(max(m.stiffer, 1.0))
    falls = max(now, SLOW_RATE) / RATE_FALLS
    calm = max(1.0 - root * m.size / m.force_slows, LEAST_CALM) / root
    m.force_cap = min(max(cap, now - falls * dt), now + calm * dt / RATE_RISES)


def _friction_slows(m: Any, x: dict[str, Array], dt: float) -> bool:
    """Whether friction is what slows the object."""
    holding = np.flatnonzero(x["holding"])
    palms, seen = x["palms"][holding], x["seen"][holding]
    used = palms_used(palms, seen)
    share = dt / (dt + m.wrench_filter)
    _press_harder(m, x, palms_need(palms, seen), share, dt)
    m.friction_used += share * (min(used.max(), 2.0) - m.friction_used)
    now = m.friction_used
    if not now > FRICTION_SLOWS:
        return False
    _ease_cap(m, max((1.0 - now) / (1.0 - FRICTION_SLOWS), 0.0), dt)
    m.why_arm = holding[used.argmax()]
    return True


def _press_harder(m: Any, x: dict[str, Array], needed: float, share: float, dt: float) -> None:
    """Raise the squeeze where the load that is felt needs more; it never falls again."""
    most = m.most_squeeze
    m.needed += share * (min(needed, most) - m.needed)
    wanted = min(SPARE_SQUEEZE * m.needed, most)
    if wanted > m.pressed_with:
        m.pressed_with = min(wanted, m.pressed_with + FIRMER * dt)
        x["target"][:] = m.pressed_with / m.squeeze * x["squeezed"]


def palms_used(palms: Array, wrenches: Array) -> Array:
    """Share of each palm's friction and pad that is used (N,); above 1 it slips or tilts, inf where it does not press.

    Args:
        palms: for friction, then for tilting, the rows of A (3, 6), then b (6,), of |A w| ≤ b·w (N, 2, 4, 6); the
            second b is the palm's normal.
        wrenches: of the arms on the object, at the origins and in the axes of the tools (N, 6) [N, N·m].
    """
    forms = np.einsum("kbij,kj->kbi", palms, wrenches)
    asked, held = np.linalg.norm(forms[:, :, :3], axis=2), forms[:, :, 3]
    share = np.full_like(held, math.inf)
    np.divide(asked, held, out=share, where=held > 0.0)
    out: Array = share.max(axis=1)
    return out


def palms_need(palms: Array, wrenches: Array) -> float:
    """The normal force with which every palm could transmit its present tangential load [N]; inf if one does not press.

    Arguments as for :func:`palms_used`.
    """
    pressed = np.einsum("kj,kj->k", palms[:, 1, 3], wrenches)
    return float((palms_used(palms, wrenches) * pressed).max()) if (pressed > 0.0).all() else math.inf
