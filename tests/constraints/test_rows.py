"""Rows, ranks and lines as values: order, stacking, and what is no line."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from coopqp import Cause, Knot, Rank
from coopqp.constraints.rate import BoundTrouble, lines_of
from coopqp.constraints.samples import PathSamples
from coopqp.constraints.velocity import ConstraintTrouble, Rows
from coopqp.spatial import Array

NOTHING: Any = None


def rows(count: int, first: int, nv: int = 3) -> Rows:
    """Rows whose every number tells which one it is."""
    n = np.arange(float(first), float(first + count))
    return Rows(np.outer(n, np.ones(nv)), -1.0 * n, 1.0 * n, 0.1 * n, n.astype(int))


def test_ranks_are_six_in_the_order_of_precedence() -> None:
    names = ["LIMITS", "CHAIN", "CLEARANCE", "PATH", "RATE", "COMFORT"]
    assert [(rank.name, int(rank)) for rank in Rank] == [(name, i) for i, name in enumerate(names)]


@pytest.mark.parametrize(
    "record", [Knot(0.0, NOTHING, np.ones(3), np.ones(3)), PathSamples(np.zeros(2), ()), rows(2, 0)]
)
def test_records_of_arrays_are_constant_and_equal_themselves_alone(record: Any) -> None:
    field = dataclasses.fields(record)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(record, field, None)
    assert record != dataclasses.replace(record)
    assert len({record, dataclasses.replace(record)}) == 2


def test_a_first_knot_has_no_grid_point_before_it() -> None:
    assert Knot(1.0, NOTHING, np.ones(3), np.ones(3)).span == 0.0


def test_trouble_keeps_what_the_step_that_holds_needs() -> None:
    some = rows(2, 0)
    told = ConstraintTrouble("constraint x raised", some, Cause.SOLVER)
    assert str(told) == "constraint x raised"
    assert told.rows is some
    assert told.cause is Cause.SOLVER
    assert ConstraintTrouble("it").rows is None
    assert ConstraintTrouble("it").cause is Cause.INPUT


class Lines:
    """Lines that a test chooses, or an error."""

    name = "lines"

    def __init__(self, lines: Any) -> None:
        self._lines = lines

    def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
        if isinstance(self._lines, Exception):
            raise self._lines
        chosen: tuple[Array, Array, Array] = self._lines
        return chosen


KNOT = Knot(0.0, NOTHING, np.ones(3), np.zeros(3))


def test_lines_may_be_vectors_lists_or_single_numbers() -> None:
    for told in ((1, 2, 3), ([1.0], [2.0], [3.0]), (np.ones(1), 2.0, [3])):
        a, b, c = lines_of(Lines(told), KNOT)
        assert (a.tolist(), b.tolist(), c.tolist()) == ([1.0], [2.0], [3.0])
    a, b, c = lines_of(Lines((np.zeros(0), np.zeros(0), np.zeros(0))), KNOT)
    assert a.size == b.size == c.size == 0


@pytest.mark.parametrize(
    ("told", "named"),
    [
        (ValueError("too hot"), "raised ValueError: too hot"),
        (None, "raised TypeError"),
        ((1.0, 2.0), "raised ValueError"),
        (("a", 1.0, 1.0), "raised ValueError"),
        (([1.0, 2.0], [1.0], [1.0]), "not finite vectors of one length"),
        (([1.0], [1.0, 2.0], [1.0]), "not finite vectors of one length"),
        (([1.0], [1.0], [1.0, 2.0]), "not finite vectors of one length"),
        ((np.ones((2, 2)), np.ones((2, 2)), np.ones((2, 2))), "not finite vectors of one length"),
        (([np.nan], [1.0], [1.0]), "not finite vectors of one length"),
        (([1.0], [np.inf], [1.0]), "not finite vectors of one length"),
        (([1.0], [1.0], [np.inf]), "not finite vectors of one length"),
    ],
)
def test_what_is_no_line_is_told(told: Any, named: str) -> None:
    with pytest.raises(BoundTrouble, match=named):
        lines_of(Lines(told), KNOT)
