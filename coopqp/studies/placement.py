"""A study of base placement: numbers that say where bases stand, a map over two of them, a search over more."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
import pinocchio as pin
from annotated_types import Ge, Le, Len
from pydantic import Field, ValidationError, model_validator

from coopqp.collision.scene import CollisionScene
from coopqp.errors import CoopqpError, UnknownNameError
from coopqp.files.cellfile import CellFileError, load_cell_task
from coopqp.files.cellfile.basic import Angle, FilePath, Name, exactly_one
from coopqp.files.cellfile.build_arm import exact_turns
from coopqp.files.cellfile.explain import explain
from coopqp.files.cellfile.paths import folder_of, resolve
from coopqp.files.cellfile.strict import Number, Table, build_options, problem, table_of
from coopqp.files.cellfile.text import read_tables
from coopqp.model.cell import RobotCell
from coopqp.scenarios import SCENARIOS
from coopqp.studies.errors import StudyError
from coopqp.studies.placed import CellPlaced, Goals
from coopqp.studies.placing import Placer

#: Largest accepted number of values of an axis, and of placements of a map.
MAX_VALUES, MAX_PLACEMENTS = 500, 100_000
#: Generations and members per dimension of a search.
_GENERATIONS, _MEMBERS = 40, 8

_Place = Number | Name


class AxisTable(Table):
    """A number that says where bases stand."""

    low: Number = Field(description="smallest value [m or deg]")
    high: Number = Field(description="largest value")
    number: Annotated[int, Ge(2), Le(MAX_VALUES)] = Field(default=21, description="values of a map")
    now: Number | None = Field(default=None, description="value as built, or as planned")

    @model_validator(mode="after")
    def _grows(self) -> AxisTable:
        if not self.low < self.high:
            raise problem("low must be below high")
        return self

    @property
    def values(self) -> list[float]:
        """The values of a map."""
        return [float(x) for x in np.linspace(self.low, self.high, self.number)]


class BaseTable(Table):
    """Where one base stands: numbers, and names of axes, as "h" or "-h"."""

    arm: Name | None = Field(default=None, description="name of the arm; or give robot")
    robot: Name | None = Field(default=None, description="name of the robot whose arms stand on the base")
    xyz_m: Annotated[list[_Place], Len(3, 3)] = Field(description="position in the world")
    yaw_deg: Angle | Name | None = Field(
        default=None, description="turn about the world's z axis (default: as in the cell)"
    )

    @model_validator(mode="after")
    def _one_name(self) -> BaseTable:
        exactly_one(self, "arm", "robot")
        return self

    def arms(self, cell: RobotCell) -> tuple[int, ...]:
        """The indices of the arms on the base.

        Raises:
            UnknownNameError: no such arm or robot.
            StudyError: the arm is a robot's, whose base moves as a whole.
        """
        if self.robot is not None:
            robots = tuple(dict.fromkeys(arm.robot for arm in cell.arms if arm.robot))
            if self.robot not in robots:
                raise UnknownNameError("robot", self.robot, robots, "bases")
            return tuple(k for k, arm in enumerate(cell.arms) if arm.robot == self.robot)
        k = cell.index(str(self.arm))
        if robot := cell.arms[k].robot:
            raise StudyError(
                f"bases: arm '{self.arm}' stands on the base of robot '{robot}', which moves as a whole. Give robot "
                f'= "{robot}" in place of the arm.'
            )
        return (k,)


if TYPE_CHECKING:
    GoalsTable = Any  # built at run time from the dataclass
else:
    GoalsTable = table_of(Goals, "GoalsTable")


class PlaceFile(Table):
    """A study of base placement."""

    name: Name = Field(description="name of the study")
    cell: FilePath | None = Field(default=None, description="cell file; or give scenario")
    scenario: Name | None = Field(default=None, description="name of a scenario")
    axes: Annotated[dict[Name, AxisTable], Len(1, 12)] = Field(description="numbers that are varied")
    bases: Annotated[list[BaseTable], Len(1, 64)] = Field(description="where bases stand; others stay")
    goals: GoalsTable = Field(
        default_factory=lambda: GoalsTable(), description="figures from which a placement is good"
    )
    distances: bool = Field(default=True, description="look at the distances of the arms, the object and obstacles")
    seed: Annotated[int, Ge(0)] = Field(default=0, description="seed of a search")

    @model_validator(mode="after")
    def _one_task(self) -> PlaceFile:
        exactly_one(self, "cell", "scenario")
        return self


@final
@dataclass(frozen=True, eq=False)
class PlaceStudy:
    """A study of base placement that was read and checked.

    Attributes:
        name: its name.
        axes: the numbers that are varied.
        placer: checks placements.
        tables: where bases stand, by number of the arm.
        seed: seed of a search.
    """

    name: str
    axes: Mapping[str, AxisTable]
    placer: Placer
    tables: Mapping[int, BaseTable]
    seed: int

    @property
    def units(self) -> dict[str, str]:
        """Unit of each axis: a length, or an angle where a yaw names it."""
        turns = {str(table.yaw_deg).removeprefix("-") for table in self.tables.values()}
        return {name: "deg" if name in turns else "m" for name in self.axes}

    def bases(self, values: Mapping[str, float]) -> list[pin.SE3]:
        """T_world_base of each arm."""
        bases = []
        for k, arm in enumerate(self.placer.cell.arms):
            table, T = self.tables.get(k), arm.T_world_base
            if table is None:
                bases.append(T)
                continue
            p = np.array([_number(entry, values) for entry in table.xyz_m])
            R = T.rotation
            if table.yaw_deg is not None:
                R = exact_turns(pin.utils.rotate("z", float(np.deg2rad(_number(table.yaw_deg, values)))))
            bases.append(pin.SE3(R, p))
        return bases

    def at(self, values: Mapping[str, float], *, quick: bool = True) -> CellPlaced:
        """The cell at values of the axes."""
        return self.placer.cell_at(self.bases(values), values=values, quick=quick)

    @property
    def now(self) -> CellPlaced | None:
        """The cell as built; None unless all axes say so."""
        values = {name: axis.now for name, axis in self.axes.items()}
        known = {name: float(value) for name, value in values.items() if value is not None}
        return self.at(known, quick=False) if len(known) == len(values) else None

    def map(self, progress: Callable[[int, int], None] | None = None) -> tuple[CellPlaced, ...]:
        """The cell at every combination of the values of one or two axes, the last axis innermost."""
        names, tell = list(self.axes), progress or (lambda *_: None)
        grid = list(itertools.product(*(self.axes[name].values for name in names)))
        found = []
        for i, point in enumerate(grid):
            found.append(self.at(dict(zip(names, point, strict=True))))
            tell(i + 1, len(grid))
        return tuple(found)

    def search(
        self, progress: Callable[[int, int], None] | None = None, *, generations: int = _GENERATIONS
    ) -> CellPlaced:
        """The best placement over any number of axes: SciPy's differential evolution, ``generations`` at most."""
        from scipy.optimize import differential_evolution

        names, tell = list(self.axes), progress or (lambda *_: None)
        total = _MEMBERS * len(names) * (generations + 1)
        best: list[CellPlaced] = []
        asked = 0

        def cost(x: Any) -> float:
            nonlocal asked
            found = self.at({name: float(v) for name, v in zip(names, x, strict=True)})
            if not best or found.rank > best[0].rank:
                best[:] = [found]
            asked += 1
            tell(min(asked, total), total)
            return -sum(share * 0.1**i for i, share in enumerate(found.rank[:4]))

        bounds = [(axis.low, axis.high) for axis in self.axes.values()]
        differential_evolution(
            cost, bounds, popsize=_MEMBERS, maxiter=generations, rng=self.seed, tol=1e-3, polish=False, init="sobol"
        )
        return best[0]


def _number(entry: Any, values: Mapping[str, float]) -> float:
    if isinstance(entry, str):
        return -values[entry[1:]] if entry.startswith("-") else values[entry]
    return float(entry)


def load_place_study(path: str | Path) -> PlaceStudy:
    """Read and check a study of base placement (TOML or YAML). Nothing is checked yet.

    Raises:
        StudyError: the file breaks the schema, or names an arm, an axis or a scenario that is not there.
        CellFileError: a file is missing or broken.
    """
    file = Path(path)
    try:
        return _study(PlaceFile.model_validate(read_tables(file)), folder_of(file))
    except ValidationError as error:
        raise StudyError(f"{file}: {explain(error)}") from error
    except CellFileError:
        raise
    except CoopqpError as error:
        raise StudyError(f"{file}: {error}") from error


def _study(file: PlaceFile, folder: Path) -> PlaceStudy:
    goals = build_options(Goals, file.goals)
    if file.cell is not None:
        task = load_cell_task(resolve(file.cell, folder, "cell"))
        cell, grasp, path = task.cell, task.grasp, task.path
        scene = task.scene or CollisionScene(cell=cell, grasp=grasp)
    else:
        if file.scenario not in SCENARIOS:
            raise UnknownNameError("scenario", str(file.scenario), SCENARIOS)
        scenario = SCENARIOS[str(file.scenario)]()
        cell, grasp, path = scenario.cell, scenario.grasp, scenario.path
        scene = CollisionScene.of(scenario)
    for table in file.bases:
        for entry in (*table.xyz_m, table.yaw_deg):
            if isinstance(entry, str) and entry.removeprefix("-") not in file.axes:
                at = f"arm '{table.arm}'" if table.robot is None else f"robot '{table.robot}'"
                raise UnknownNameError("axis", entry.removeprefix("-"), file.axes, f"bases: {at}")
    tables: dict[int, BaseTable] = {}
    for table in file.bases:
        for k in table.arms(cell):
            if k in tables:
                raise StudyError(
                    f"bases: {'an arm' if table.robot is None else 'a robot'} has two tables. Give it one."
                )
            tables[k] = table
    if len(file.axes) <= 2 and np.prod([axis.number for axis in file.axes.values()]) > MAX_PLACEMENTS:
        raise StudyError(f"axes: more than {MAX_PLACEMENTS} placements. Take fewer values.")
    placer = Placer(cell, grasp, path, goals=goals, scene=scene if file.distances else None)
    return PlaceStudy(file.name, file.axes, placer, tables, file.seed)
