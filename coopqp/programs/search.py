"""A phase that searches its way: what a program asks of a search, and where the arms are when it begins."""

from __future__ import annotations

import abc
import math

import numpy as np

from coopqp.errors import UnreachableError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import newton
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array, Placement

#: Clocks at which joints are taken along the phases before, at most so far apart [s].
_EVERY = 0.02


class SearchedWay(abc.ABC):
    """The path of a phase that is searched when the program is built: :class:`coopqp.planning.Search`."""

    #: Where the object is when a first phase begins; others begin where the phase before ends.
    start: Placement | None = None

    @abc.abstractmethod
    def found(self, cell: RobotCell, grasp: Grasp, start: Placement, q: Array | None, where: str) -> ObjectPath:
        """The way from a pose on.

        Args:
            cell, grasp: the arms, and how they hold the object where the way begins.
            start, q: pose of the object there; configuration (nq,), found where it is None.
            where: of messages.

        Raises:
            UnreachableError, UndecidedError: there is none, or none was found; the message names the phase.
            InvalidInputError: the way is none for a phase.
        """


def configuration_at_end(cell: RobotCell, grasp: Grasp, program: ObjectPath, q: Array) -> Array:
    """Where the joints are (nq,) at the end of a program that begins near ``q`` (nq,).

    Raises:
        UnreachableError: an arm cannot follow it.
    """
    chain, motion = Chain(cell, grasp), program.grasps
    count = max(2, math.ceil(program.duration / _EVERY) + 1)
    for clock in np.linspace(0.0, program.duration, count).tolist():
        if motion is not None:
            chain.place(motion.placements(clock))
        apart = () if motion is None else motion.apart(clock)
        for k in apart:
            x, way = cell.positions(q), motion.leading(k, clock) if motion is not None else None
            assert way is not None
            x[chain.moving_columns[k]] = way.at(clock)[0]
            q = cell.configuration(x)
        chain.apart = apart
        q, errors = newton(chain, program.pose(clock), q, tolerance=1e-9, max_iter=20)
        if not np.abs(errors).max() < 1e-6:
            raise UnreachableError(f"the arms cannot follow the phases before the search beyond {clock:.2f} s.")
    return q
