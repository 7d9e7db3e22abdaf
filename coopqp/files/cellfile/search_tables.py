"""The path of kind ``search`` of a cell file: start and goal, between which a way round is searched."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import Ge, Le, Len
from pydantic import Field, model_validator

from coopqp.files.cellfile.basic import Angle, PlacementTable, Position, Seconds
from coopqp.files.cellfile.strict import Table, problem

#: Largest accepted number of poses in the trees.
MAX_NODES = 1_000_000


class FreeTurnTable(Table):
    """A turn of the object about an axis of its own frame that is left free."""

    axis: Literal["rx", "ry", "rz"] = Field(description="the axis")
    range_deg: Annotated[list[Angle], Len(2, 2)] = Field(
        default=[-180.0, 180.0], description="lowest and highest angle from the pose"
    )

    @model_validator(mode="after")
    def _in_order(self) -> FreeTurnTable:
        low, high = self.range_deg
        if not -360.0 <= low <= high <= 360.0:
            raise problem("range_deg: give the lower angle first, from -360 to 360")
        return self


class GoalTable(PlacementTable):
    """Pose of the object frame at the end, and its free turns."""

    free: Annotated[list[FreeTurnTable], Len(0, 3)] = Field(default=[], description="turns that are left free")


class RegionTable(Table):
    """Where the origin of the object frame may go."""

    low_m: Position = Field(description="lowest x, y and z")
    high_m: Position = Field(description="highest x, y and z")


class SearchTable(Table):
    """A way round what stands between start and goal, searched when the file is read: see `coopqp route`."""

    kind: Literal["search"]
    start: PlacementTable = Field(description="pose of the object frame in the world at the start")
    goal: GoalTable = Field(description="pose at the end")
    region: RegionTable | None = Field(
        default=None, description="where it may go; by default 0.3 m below to 0.4 m above start and goal"
    )
    clearance_m: Annotated[float, Ge(0.0), Le(1.0)] = Field(
        default=0.0, description="distance that is kept beyond the margins of the table collision"
    )
    time_limit_s: Seconds = Field(default=10.0, description="the longest search")
    nodes: Annotated[int, Ge(1), Le(MAX_NODES)] = Field(
        # A number, and not None: no clock shapes the way, so that every command finds, proves and runs the same one.
        default=100_000,
        description="poses, and samples that lead to none, that end the search",
    )
    seed: Annotated[int, Ge(0)] = Field(default=0, description="seed of the search")
    speed_m_per_s: Annotated[float, Ge(1e-3), Le(10.0)] = Field(
        default=0.25, description="largest speed along the way at full rate; 1 rad counts as 0.3 m"
    )

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of :func:`coopqp.find_path` beside start, goal and bodies."""
        region = {} if self.region is None else {"region": [self.region.low_m, self.region.high_m]}
        given = {"time_limit": self.time_limit_s, "seed": self.seed, "clearance": self.clearance_m, "nodes": self.nodes}
        return given | region
