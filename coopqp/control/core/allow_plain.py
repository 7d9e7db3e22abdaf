"""The rate of the object that forces allow, in NumPy, as in ``allow.cpp``. See :mod:`coopqp.forces`."""

from __future__ import annotations

import math

import numpy as np

from coopqp.control.core.relax_plain import AT, MOVING, SENSORS_FINE, minding_views
from coopqp.native import layout
from coopqp.native.constants import FIRMER, FRICTION_SLOWS, LEAST_CALM, RATE_FALLS, RATE_RISES, SLOW_RATE, SPARE_SQUEEZE
from coopqp.spatial import Array

NOTHING_MORE, BY_SENSOR, BY_REACH, BY_STAGE, BY_FRICTION, BY_FORCE, BY_CONTACT = range(len(layout.WHYS))


def allow(memory: Array, arms: int, dt: float, /) -> None:
    """Find the largest rate of the object now, ALLOWED, and WHY it is less than the wanted rate."""
    m = memory
    size, slows, asked = m[AT["SIZE"]], m[AT["FORCE_SLOWS"]], m[AT["ASKED"]]
    m[AT["ALLOWED"]], why = 0.0, NOTHING_MORE
    if m[AT["SENSOR_FAULT"]] != SENSORS_FINE:
        why = BY_SENSOR
    elif m[AT["TOUCHES"]]:
        why = BY_CONTACT
    elif m[AT["SATURATED"]] and size > slows:
        why = BY_REACH
    elif m[AT["STAGE"]] != MOVING:
        why = BY_STAGE
    m[AT["WHY"]] = why
    if why != NOTHING_MORE:
        return
    if m[AT["HAS_PALMS"]] and _friction_slows(m, minding_views(m, arms), dt):
        m[AT["WHY"]], m[AT["ALLOWED"]] = BY_FRICTION, min(m[AT["FORCE_CAP"]], asked)
        return
    holds = m[AT["FORCE_HOLDS"]]
    _ease_cap(m, min(max((holds - size) / (holds - slows), 0.0), 1.0), dt)
    cap = m[AT["FORCE_CAP"]]
    m[AT["WHY"]], m[AT["ALLOWED"]] = NOTHING_MORE if cap >= asked else BY_FORCE, min(cap, asked)


def _ease_cap(m: Array, cap: float, dt: float) -> None:
    """Let the rate that forces allow come closer to ``cap``.

    It falls in proportion to itself, as braking makes forces of its own, and rises the less, the more is felt, and the
    stiffer the servos are.
    """
    now = m[AT["FORCE_CAP"]]
    falls = max(now, SLOW_RATE) / RATE_FALLS
    calm = max(1.0 - m[AT["SIZE"]] / m[AT["FORCE_SLOWS"]], LEAST_CALM) / math.sqrt(max(m[AT["STIFFER"]], 1.0))
    m[AT["FORCE_CAP"]] = min(max(cap, now - falls * dt), now + calm * dt / RATE_RISES)


def _friction_slows(m: Array, x: dict[str, Array], dt: float) -> bool:
    """Whether friction is what slows the object."""
    used = palms_used(x["palms"], x["seen"])
    share = dt / (dt + m[AT["WRENCH_FILTER"]])
    _press_harder(m, x, palms_need(x["palms"], x["seen"]), share, dt)
    m[AT["FRICTION_USED"]] += share * (min(used.max(), 2.0) - m[AT["FRICTION_USED"]])
    now = m[AT["FRICTION_USED"]]
    if not now > FRICTION_SLOWS:
        return False
    _ease_cap(m, max((1.0 - now) / (1.0 - FRICTION_SLOWS), 0.0), dt)
    m[AT["WHY_ARM"]] = used.argmax()
    return True


def _press_harder(m: Array, x: dict[str, Array], needed: float, share: float, dt: float) -> None:
    """Raise the squeeze where the load that is felt needs more; it never falls again."""
    most, pressed = m[AT["MOST_SQUEEZE"]], AT["PRESSED_WITH"]
    m[AT["NEEDED"]] += share * (min(needed, most) - m[AT["NEEDED"]])
    wanted = min(SPARE_SQUEEZE * m[AT["NEEDED"]], most)
    if wanted > m[pressed]:
        m[pressed] = min(wanted, m[pressed] + FIRMER * dt)
        x["target"][:] = m[pressed] / m[AT["SQUEEZE"]] * x["squeezed"]


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
