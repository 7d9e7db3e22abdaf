"""Bounds of the object's rate at the grid points ahead of it, as lines: for the look-ahead and the fastest timing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from coopqp.checks import ArrayLike
from coopqp.errors import said
from coopqp.model.state import CellState
from coopqp.spatial import Array


@dataclass(frozen=True, eq=False)
class Knot:
    """The chain at one clock of the path ahead: joints move at ``q′ σ`` and accelerate at ``q′ σ̇ + q″ σ²``.

    The fastest timing (:func:`coopqp.planning.time_path`) does not know when the object will be where. There the clock
    is that of a run at constant speed, from 0 to the path's duration; of a geometry without a duration, at 1 m/s.

    Attributes:
        clock: the object's clock [s].
        state: kinematics there.
        slope: q′ (nv,) [rad or m per clock second].
        curvature: q″ (nv,), its mean since the grid point before.
        span: since the grid point before [s]; 0 at the first one.
    """

    clock: float
    state: CellState
    slope: Array
    curvature: Array
    span: float = 0.0


@runtime_checkable
class RateBound(Protocol):
    """Lines that the object's rate σ, and its change σ̇, have to keep at every grid point of the look-ahead.

    They hold on paths that are looked ahead on, and while the object follows its path: a hold brakes as hard as the
    joints' own limits allow.

    Attributes:
        name: how ``ControlStep.binding`` calls it.
    """

    name: str

    def lines(self, knot: Knot) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        """a, b and c (m,), or one number each, with ``a z + b σ̇ ≤ c``, z = σ².

        At z = 0 and σ̇ = 0 they have to hold: c ≥ 0.
        """
        ...


class BoundTrouble(Exception):  # noqa: N818
    """A rate bound raised, or returned something else than lines. Its text goes on after the bound's name."""


def lines_of(bound: RateBound, knot: Knot) -> tuple[Array, Array, Array]:
    """a, b and c (m,) of a rate bound at a grid point.

    Raises:
        BoundTrouble: it raised, or returned something else than finite vectors of one length.
    """
    try:
        a, b, c = (np.atleast_1d(np.asarray(x, dtype=float)) for x in bound.lines(knot))
    except Exception as error:
        raise BoundTrouble(f" raised {said(error)}") from error
    if not (a.shape == b.shape == c.shape == (a.size,) and np.isfinite([a, b, c]).all()):
        raise BoundTrouble(": its a, b and c are not finite vectors of one length")
    return a, b, c
