"""The paths of a cell file: a line, waypoints, a rest, and a planned path."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Le, Len
from pydantic import Field, model_validator

from coopqp.files.cellfile.basic import Angles, PlacementTable, Position, Seconds, exactly_one
from coopqp.files.cellfile.strict import MAX_LIST, Table, problem

#: Largest accepted number of waypoints.
MAX_WAYPOINTS = 1_000


class DisplacementTable(Table):
    """From the start: a translation, and a rotation about the object frame's origin, in world axes."""

    translation_m: Position = Field(default=[0.0, 0.0, 0.0], description="translation")
    rotation_vector_deg: Angles = Field(default=[0.0, 0.0, 0.0], description="axis times angle")


TimeLawName = Literal["quintic", "linear"]


class LineTable(Table):
    """A straight line with a turn about one axis."""

    kind: Literal["line"]
    start: PlacementTable = Field(description="pose of the object frame in the world at the start")
    goal: PlacementTable | None = Field(default=None, description="pose at the end; or give displacement")
    displacement: DisplacementTable | None = Field(default=None, description="displacement in place of goal")
    duration_s: Seconds = Field(description="duration at full rate")
    time_law: TimeLawName = Field(default="quintic", description="quintic: rest to rest; linear: velocity jumps")

    @model_validator(mode="after")
    def _one_end(self) -> LineTable:
        exactly_one(self, "goal", "displacement")
        return self


class WaypointsTable(Table):
    """Straight lines through several poses."""

    kind: Literal["waypoints"]
    poses: Annotated[list[PlacementTable], Len(2, MAX_WAYPOINTS)] = Field(description="poses of the object frame")
    durations_s: Annotated[list[Seconds], Len(1, MAX_WAYPOINTS)] = Field(
        description="duration of each segment at full rate"
    )
    time_law: TimeLawName = Field(default="quintic", description="time law of every segment")

    @model_validator(mode="after")
    def _fits(self) -> WaypointsTable:
        if len(self.durations_s) != len(self.poses) - 1:
            raise problem(
                f"{len(self.poses)} poses need {len(self.poses) - 1} durations_s, not {len(self.durations_s)}"
            )
        return self


class HoldTable(Table):
    """The object rests at one pose."""

    kind: Literal["hold"]
    pose: PlacementTable = Field(description="pose of the object frame in the world")
    duration_s: Seconds = Field(description="duration")


class BindingTable(Table):
    """What limit a planned path uses up, from when to when."""

    from_s: Annotated[float, Ge(0.0)] = Field(description="time along the path")
    to_s: Annotated[float, Ge(0.0)] = Field(description="time along the path")
    arm: str = Field(description="name of the arm")
    joint: str = Field(description="name of the joint")
    limit: Literal["velocity", "acceleration", "torque", "jerk"] = Field(description="kind of the limit")


Rows = Annotated[list[Annotated[list[float], Len(1, MAX_LIST)]], Len(2, MAX_LIST)]


class ElbowsTable(Table):
    """The planned motion of redundant arms, along which they are led."""

    clocks_s: Annotated[list[float], Len(2, MAX_LIST)] = Field(description="times along the path")
    positions_rad: Rows = Field(description="positions of all joints at each [rad or m]")
    speeds_rad_per_s: Rows = Field(description="their speeds there [rad/s or m/s]")


class TimedTable(Table):
    """A path with its speed profile, as `coopqp plan` writes it."""

    kind: Literal["timed"]
    pieces: Annotated[list[Annotated[list[float], Len(19, 25)]], Len(1, 2 * MAX_WAYPOINTS)] = Field(
        description="numbers of each piece of the geometry: coopqp.TimedPath.record"
    )
    s_m: Annotated[list[float], Len(2, MAX_LIST)] = Field(description="grid points: the object's motion from the start")
    squares: Annotated[list[float], Len(2, MAX_LIST)] = Field(description="square of the speed at each of them [m²/s²]")
    planned_share: Annotated[float, Ge(1e-6), Le(1.0)] | None = Field(
        default=None, description="share of the joints' limits that it was planned with"
    )
    keeps_clear: bool = Field(
        default=False,
        description="the planned motion is proved to keep clear of the bodies: redundant arms do not evade on it",
    )
    elbows: ElbowsTable | None = Field(
        default=None, description="the planned motion of redundant arms, along which they are led"
    )
    binding: Annotated[list[BindingTable], Len(0, MAX_LIST)] = Field(
        default_factory=list, description="what limit binds when; it changes nothing"
    )
