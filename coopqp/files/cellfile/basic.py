"""Types that tables of a cell file share: names, lengths, placements."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Le, Len
from pydantic import AfterValidator, Field, model_validator

from coopqp.errors import has_controls, printable, shown
from coopqp.files.cellfile.strict import MAX_LIST, Table, problem

#: Largest accepted number of arms.
MAX_ARMS = 128
#: Largest accepted length of a position [m], of an angle [deg or rad], and of a path in characters.
MAX_METRES, MAX_ANGLE, MAX_PATH = 1e4, 1e6, 4096
#: Smallest and largest accepted stiffness of a servo [N·m/rad or N/m].
_SOFTEST, _STIFFEST = 1e-3, 1e9


def _plain(text: str) -> str:
    if has_controls(text):
        raise problem(f"{printable(shown(text))} has control characters; give plain text")
    return text


Name = Annotated[str, Len(1, 100), AfterValidator(_plain)]
FilePath = Annotated[str, Len(1, MAX_PATH), AfterValidator(_plain)]
Seconds = Annotated[float, Ge(1e-6), Le(1e5)]
Metres = Annotated[float, Ge(1e-4), Le(1e3)]
Angle = Annotated[float, Ge(-MAX_ANGLE), Le(MAX_ANGLE)]
Position = Annotated[list[Annotated[float, Ge(-MAX_METRES), Le(MAX_METRES)]], Len(3, 3)]
Angles = Annotated[list[Angle], Len(3, 3)]
Positions = Annotated[list[Angle], Len(1, MAX_LIST)]
Unbounded = Annotated[float, Field(allow_inf_nan=True)]
Sides = Annotated[list[Metres], Len(3, 3)]
PerJoint = Unbounded | Annotated[list[Unbounded], Len(1, 100)]
Degrees = Annotated[dict[Name, Positions], Len(1, MAX_ARMS)]


def _stiff(value: float | list[float]) -> float | list[float]:
    for x in value if isinstance(value, list) else [value]:
        if not _SOFTEST <= x <= _STIFFEST:
            raise problem(f"must be from {_SOFTEST:g} to {_STIFFEST:g}, not {x:g}")
    return value


Stiffness = Annotated[float | Annotated[list[float], Len(1, 100)], AfterValidator(_stiff)]


def exactly_one(table: Table, *keys: str) -> str:
    """Return the given one of ``keys``; an error if none or several are given."""
    given = [key for key in keys if getattr(table, key) is not None]
    if len(given) != 1:
        raise problem(f"give one of {', '.join(keys)}" + (f", not {' and '.join(given)}" if given else ""))
    return given[0]


def at_most_one(table: Table, *keys: str) -> None:
    """Raise an error if more than one of ``keys`` is given."""
    given = [key for key in keys if getattr(table, key) is not None]
    if len(given) > 1:
        raise problem(f"give {' or '.join(given)}, not both")


class PlacementTable(Table):
    """A placement: a position with an orientation, or a 4x4 matrix."""

    xyz_m: Position | None = Field(default=None, description="position (default 0, 0, 0)")
    rpy_deg: Angles | None = Field(default=None, description="turns about the fixed x, y and z axes, in this order")
    rpy_rad: Angles | None = Field(default=None, description="the same in radians")
    matrix: (
        Annotated[list[Annotated[list[Annotated[float, Ge(-MAX_METRES), Le(MAX_METRES)]], Len(4, 4)]], Len(4, 4)] | None
    ) = Field(default=None, description="rows of the homogeneous matrix [m], in place of the other keys")

    @model_validator(mode="after")
    def _one_form(self) -> PlacementTable:
        at_most_one(self, "rpy_deg", "rpy_rad", "matrix")
        at_most_one(self, "xyz_m", "matrix")
        return self
