"""The weights W_k of the common error ``ē = Σ_k W_k e_k``: they define the object pose from the views of the arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from coopqp.checks import NOT_NUMBERS, ArrayLike, as_floats
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array


@final
@dataclass(frozen=True, eq=False)
class CommonError:
    """Diagonal weights of the arms' errors, per axis of the object frame. They sum to 1 on every axis.

    Build it with :meth:`leader`, :meth:`leaderless`, :meth:`driver` or :meth:`per_axis`.
    """

    kind: str
    arms: tuple[str | int, ...] = ()
    weights: ArrayLike | None = None

    @staticmethod
    def leader(arm: str | int = 0) -> CommonError:
        """The leader defines the object pose, the other arms follow: master and slaves of the paper's mode II."""
        return CommonError("leader", (arm,))

    @staticmethod
    def leaderless() -> CommonError:
        """All arms have the same weight."""
        return CommonError("leaderless")

    @staticmethod
    def driver(*, leader: str | int, driver: str | int) -> CommonError:
        """The leader positions the object, the driver orients it: master and driver of the paper's mode I."""
        return CommonError("driver", (leader, driver))

    @staticmethod
    def per_axis(weights: ArrayLike) -> CommonError:
        """Any weights (N, 6) ≥ 0 that sum to 1 over the arms on every axis [x, y, z, rx, ry, rz]."""
        return CommonError("per_axis", (), weights)

    def shares(self, cell: RobotCell) -> Array:
        """The weights for a cell, shape (N, 6).

        Raises:
            UnknownNameError: no such arm.
            InvalidInputError: wrong shape, a negative weight, or sums other than 1.
        """
        n = len(cell)
        W = np.zeros((n, 6))
        arms = [cell.index(arm) for arm in self.arms]
        if self.kind == "leader":
            W[arms[0]] = 1.0
        elif self.kind == "leaderless":
            W[:] = 1.0 / n
        elif self.kind == "driver":
            W[arms[0], :3] = 1.0
            W[arms[1], 3:] = 1.0
        else:
            try:
                W = as_floats(self.weights)
            except NOT_NUMBERS as error:
                raise InvalidInputError(f"not numbers ({error})", "CommonError.per_axis", f"Give ({n}, 6).") from error
            if W.shape != (n, 6) or not np.all(W >= 0.0) or np.abs(W.sum(axis=0) - 1.0).max() > 1e-9:
                raise InvalidInputError(
                    f"weights of shape {W.shape} that are not ≥ 0 with column sums 1",
                    "CommonError.per_axis",
                    f"Give shape ({n}, 6), one row per arm; every column sums to 1.",
                )
        return W

    def shares_of(self, cell: RobotCell, holds: Sequence[bool]) -> Array:
        """The weights (N, 6) while only some arms hold the object (N,).

        The others have none. On an axis of which no holding arm has a share, all that hold have the same.
        """
        W, holding = self.shares(cell).copy(), np.array(holds, dtype=float)[:, None]
        if holding.all():
            return W
        W *= holding
        sums = W.sum(axis=0)
        alike: Array = holding / max(float(holding.sum()), 1.0)
        return np.where(sums > 0.0, W / np.where(sums > 0.0, sums, 1.0), alike)
