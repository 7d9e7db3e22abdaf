"""Phases of a program in a cell file: ``[[phases]]``, with the arms' names in ``[phases.arms.NAME]``."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from annotated_types import Len
from pydantic import Field, model_validator

from coopqp.files.cellfile.basic import (
    MAX_ARMS,
    Angle,
    Name,
    PlacementTable,
    Position,
    Seconds,
    exactly_one,
)
from coopqp.files.cellfile.path_tables import HoldTable, LineTable, Rows, TimedTable, WaypointsTable
from coopqp.files.cellfile.search_tables import SearchTable
from coopqp.files.cellfile.strict import Table
from coopqp.paths.grasp_motion import ATTACH_RAD

#: Most phases of a program.
MAX_PHASES = 1000


class HoldsTable(Table):
    """The arm holds the object; what an arm does that is not named."""

    kind: Literal["holds"]


class WaitsTable(Table):
    """The arm goes along with the object without holding it."""

    kind: Literal["waits"]


class TravelsTable(Table):
    """The arm lets go, and holds the object at another place after the phase."""

    kind: Literal["travels"]
    to: PlacementTable = Field(description="the new placement of its tool in the object frame")
    retreat_m: Annotated[float, Field(ge=0.0, le=10.0)] = Field(
        default=0.05, description="way back along the tool's z axis at both places"
    )


class WorksTable(Table):
    """The tool follows poses on the object, and does not hold it. The first is where it is."""

    kind: Literal["works"]
    poses: Annotated[list[PlacementTable], Len(2, 1000)] = Field(description="poses of the tool in the object frame")
    durations_s: Annotated[list[Seconds], Len(1, 1000)] = Field(description="duration of each segment at full rate")
    time_law: Literal["quintic", "linear"] = Field(default="quintic", description="time law of every segment")


class TurnsTable(Table):
    """The part of the object that the arm holds turns about a pin."""

    kind: Literal["turns"]
    about_m: Position = Field(description="a point of the pin in the object frame")
    axis: Position = Field(default=[0.0, 0.0, 1.0], description="direction of the pin in the object frame")
    angle_deg: Angle | None = Field(default=None, description="angle")
    angle_rad: Angle | None = Field(default=None, description="the same in radians")
    holds: bool = Field(default=True, description="false: the tool goes round without holding the object")

    @model_validator(mode="after")
    def _one_unit(self) -> TurnsTable:
        exactly_one(self, "angle_deg", "angle_rad")
        return self


class SlidesTable(Table):
    """The part of the object that the arm holds slides along an axis."""

    kind: Literal["slides"]
    axis: Position = Field(description="direction in the object frame")
    distance_m: Annotated[float, Field(ge=-100.0, le=100.0)] = Field(description="how far")


class FollowsJointsTable(Table):
    """The arm does not hold the object, and follows a way of its joints."""

    kind: Literal["follows_joints"]
    positions_deg: Rows | None = Field(
        default=None, description="rows of joint positions; the first is where the arm is"
    )
    positions_rad: Rows | None = Field(default=None, description="the same in radians")
    speeds_rad_per_s: Rows | None = Field(default=None, description="speeds at each row; without they rest there")
    durations_s: Annotated[list[Seconds], Len(1, 1000)] = Field(description="duration of each way at full rate")

    @model_validator(mode="after")
    def _one_unit(self) -> FollowsJointsTable:
        exactly_one(self, "positions_deg", "positions_rad")
        return self


class FollowsTable(Table):
    """The tool follows a timed path in a frame on the object, as `coopqp plan` writes it."""

    kind: Literal["follows"]
    frame: PlacementTable = Field(description="the placement on the object in whose axes the path is")
    path: Annotated[TimedTable | HoldTable, Field(discriminator="kind")] = Field(
        description="the path of a frame; only its motion from its start counts"
    )
    holds: bool = Field(default=True, description="whether the arm holds the object meanwhile")
    holds_after: bool | None = Field(default=None, description="whether it does after the phase")


RoleTable = Annotated[
    HoldsTable | WaitsTable | TravelsTable | WorksTable | TurnsTable | SlidesTable | FollowsTable | FollowsJointsTable,
    Field(discriminator="kind"),
]


class AttachTable(Table):
    """How far from its grasp a tool may be where it attaches; beyond, the arms hold."""

    distance_mm: Annotated[float, Field(gt=0.0, le=100.0)] = Field(default=2.0, description="largest distance")
    angle_deg: Annotated[float, Field(gt=0.0, le=90.0)] = Field(
        default=round(float(np.rad2deg(ATTACH_RAD)), 6), description="largest angle"
    )


class PhaseLineTable(LineTable):
    """A straight line with a turn about one axis, from where the phase before ends."""

    start: PlacementTable | None = Field(  # type: ignore[assignment]
        default=None, description="pose at the start (where the phase before ends)"
    )


class PhaseSearchTable(SearchTable):
    """A way round from where the phase before ends to a goal, searched when the file is read."""

    start: PlacementTable | None = Field(  # type: ignore[assignment]
        default=None, description="pose at the start (where the phase before ends)"
    )


class PhaseTable(Table):
    """A part of a program: the object's path, what each arm does, and what is waited for at the end."""

    name: Name = Field(description="unique name of the phase")
    path: (
        Annotated[PhaseLineTable | WaypointsTable | TimedTable | PhaseSearchTable, Field(discriminator="kind")] | None
    ) = Field(default=None, description="path of the object; by default it rests")
    duration_s: Seconds | None = Field(default=None, description="duration of a phase in which the object rests")
    until: Name | None = Field(default=None, description="the signal that the object waits for at the end")
    arms: Annotated[dict[Name, RoleTable], Len(0, MAX_ARMS)] = Field(
        default={}, description="what an arm does, by its name; others hold the object"
    )
