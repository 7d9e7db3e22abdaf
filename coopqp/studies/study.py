"""A study file: variations of a cell file or a scenario, and the rows that they make."""

from __future__ import annotations

import copy
import hashlib
import inspect
import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, final

import numpy as np
from annotated_types import Ge, Le, Len
from pydantic import Field, ValidationError, model_validator

from coopqp.errors import CoopqpError, UnknownNameError, shortened, shown
from coopqp.files.cellfile.basic import FilePath, Name, Seconds, exactly_one
from coopqp.files.cellfile.explain import explain
from coopqp.files.cellfile.paths import folder_of, resolve
from coopqp.files.cellfile.schema import (
    MAX_STEPS,
    CellFile,
    ControllerTable,
    KinematicTable,
    PlantTable,
    QPTable,
    VerdictTable,
)
from coopqp.files.cellfile.strict import Number, Table, problem
from coopqp.files.cellfile.text import read_tables
from coopqp.scenarios import SCENARIOS
from coopqp.simulation.evaluation.assessment import Tolerances
from coopqp.simulation.simulate import PATIENCE
from coopqp.studies.drawing import DisturbancesTable
from coopqp.studies.errors import StudyError
from coopqp.studies.table import FIGURES
from coopqp.version import __version__

#: Largest accepted number of rows, and of values of an axis.
MAX_ROWS, MAX_VALUES = 1_000_000, 10_000
#: Largest accepted number of parts of a dotted key.
MAX_PARTS = 50


class RangeTable(Table):
    """Numbers at equal distances, or at equal ratios."""

    low: Number = Field(description="first number")
    high: Number = Field(description="last number")
    number: Annotated[int, Ge(1), Le(MAX_VALUES)] = Field(description="how many")
    log: bool = Field(default=False, description="equal ratios instead of equal distances")

    @model_validator(mode="after")
    def _has_ratios(self) -> RangeTable:
        if self.log and not self.low * self.high > 0.0:
            raise problem(
                f"log = true needs two numbers of one sign, not {self.low:g} and {self.high:g}: 0 has no ratio"
            )
        return self

    def values(self) -> list[float]:
        """The numbers."""
        spaced = np.geomspace if self.log else np.linspace
        return [float(x) for x in spaced(self.low, self.high, self.number)]


class CaseTable(Table):
    """Several keys that change together."""

    name: Name = Field(description="name of the case, in the column `case`")
    set: dict[str, Any] = Field(description="values by dotted key")


class StudyFile(Table):
    """A study: rows are all combinations of the cases, the axes, the draws and the repeats."""

    name: Name = Field(description="name of the study")
    cell: FilePath | None = Field(default=None, description="cell file that is varied; or give scenario")
    scenario: Name | None = Field(default=None, description="scenario that is varied")
    seed: Annotated[int, Ge(0), Le(2**63)] = Field(default=0, description="seed of all random numbers")
    draws: Annotated[int, Ge(1), Le(MAX_ROWS)] = Field(default=1, description="draws of the disturbances")
    repeats: Annotated[int, Ge(1), Le(MAX_ROWS)] = Field(
        default=1, description="runs of each draw; they differ in the noise"
    )
    timeout_s: Seconds = Field(default=600.0, description="a run that takes longer has failed [s of wall time]")
    set: dict[str, Any] = Field(default={}, description="values by dotted key, the same in all rows")
    cases: Annotated[list[CaseTable], Len(0, MAX_VALUES)] = Field(default=[], description="keys that change together")
    axes: dict[str, Any] = Field(
        default={}, description="values by dotted key: a list, or { low, high, number, log = false }"
    )
    disturbances: dict[str, Any] = Field(default={}, description="amounts of what each draw disturbs")
    figures: Annotated[list[Name], Len(0, 12)] = Field(
        default=["chain_mm", "object_mm", "time_s"], description="columns that are drawn"
    )

    @model_validator(mode="after")
    def _one_task(self) -> StudyFile:
        exactly_one(self, "cell", "scenario")
        return self


class ScenarioFile(Table):
    """Settings of a scenario that can vary: its own arguments, the controller, the plant, the loop."""

    scenario: dict[str, Any] = Field(default={}, description="arguments of the scenario's function")
    controller: ControllerTable = Field(default_factory=lambda: QPTable.model_validate({"kind": "qp"}))
    plant: PlantTable = Field(default_factory=lambda: KinematicTable(kind="kinematic"))
    dt_s: Seconds | None = Field(default=None, description="length of a step (default: the scenario's)")
    steps: Annotated[int, Ge(1), Le(MAX_STEPS)] | None = Field(default=None, description="steps of an unslowed run")
    settle_s: Annotated[float, Ge(0.0), Le(1e5)] = Field(default=0.0)
    patience_s: Seconds = Field(default=PATIENCE)
    longest_s: Seconds | None = Field(default=None)
    verdict: VerdictTable = Field(default_factory=lambda: VerdictTable(**vars(Tolerances())))


@dataclass(frozen=True)
class Row:
    """One row of a study.

    Attributes:
        index: its number, from 0.
        values: the varied settings, by column.
        draw, repeat: number of the draw of the disturbances, and of the run within its draw.
    """

    index: int
    values: Mapping[str, Any]
    draw: int
    repeat: int


@final
@dataclass(frozen=True, eq=False)
class Study:
    """A study that was read and checked. It travels to the workers.

    Attributes:
        name: its name.
        base: the cell file, or the :class:`ScenarioFile` of a scenario, as plain data.
        folder: folder of the cell file.
        scenario: name of the scenario; empty for a cell file.
        cases: name, and values by dotted key, of each case.
        axes: values of each axis, by dotted key.
        disturbances: amounts of the disturbances as plain data.
        draws, repeats, seed, timeout_s, figures: as in the file.
    """

    name: str
    base: Mapping[str, Any]
    folder: str
    scenario: str
    cases: tuple[tuple[str, Mapping[str, Any]], ...]
    axes: tuple[tuple[str, tuple[Any, ...]], ...]
    disturbances: Mapping[str, Any]
    draws: int
    repeats: int
    seed: int
    timeout_s: float
    figures: tuple[str, ...]

    def __len__(self) -> int:
        lengths = [len(values) for _, values in self.axes]
        return max(1, len(self.cases)) * math.prod(lengths) * self.draws * self.repeats

    def __repr__(self) -> str:
        return f"Study({self.name}: {len(self)} rows over {', '.join(self.varied) or 'nothing'})"

    @property
    def varied(self) -> tuple[str, ...]:
        """Columns of the varied settings."""
        return (*(("case",) if self.cases else ()), *(key for key, _ in self.axes))

    @property
    def digest(self) -> str:
        """A hash of all that decides about the rows."""
        text = json.dumps({**vars(self), "folder": ""}, sort_keys=True, ensure_ascii=True, default=list)
        return hashlib.sha256(text.encode()).hexdigest()

    def row(self, index: int) -> Row:
        """The row of a number: cases and axes outermost, then draws, then repeats."""
        rest, repeat = divmod(index, self.repeats)
        rest, draw = divmod(rest, self.draws)
        values: dict[str, Any] = {}
        for key, choices in reversed(self.axes):
            rest, i = divmod(rest, len(choices))
            values[key] = choices[i]
        if self.cases:
            values["case"] = self.cases[rest][0]
        return Row(index, {key: values[key] for key in self.varied}, draw, repeat)

    def data(self, values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """The data of the run, and of its disturbances, with the values of a row.

        Raises:
            StudyError: a dotted key leads nowhere.
        """
        data = copy.deepcopy({**self.base, "disturbances": dict(self.disturbances)})
        data.setdefault("controller", {"kind": "qp"})
        changes = dict(self.cases).get(values.get("case", ""), {})
        for key, value in (*changes.items(), *((k, v) for k, v in values.items() if k != "case")):
            put(data, key, copy.deepcopy(value))
        disturbed = data.pop("disturbances")
        return data, disturbed

    def settings(self, values: Mapping[str, Any]) -> tuple[CellFile | ScenarioFile, DisturbancesTable]:
        """The checked settings of a row.

        Raises:
            StudyError: a key leads nowhere, or a value breaks the schema.
        """
        data, disturbed = self.data(values)
        try:
            kind: Any = ScenarioFile if self.scenario else CellFile
            settings: CellFile | ScenarioFile = kind.model_validate(data)
            if isinstance(settings, ScenarioFile):
                _check_arguments(self.scenario, settings.scenario)
        except ValidationError as error:
            raise StudyError(explain(error)) from error
        try:
            return settings, DisturbancesTable.model_validate(disturbed)
        except ValidationError as error:
            raise StudyError(f"disturbances: {explain(error)}") from error


def put(data: Any, key: str, value: Any) -> None:
    """Set a dotted key: names of tables, numbers of entries of lists, or the names of tables in lists (arms.left.base).

    Raises:
        StudyError: the key leads nowhere.
    """
    parts = key.split(".")
    if len(parts) > MAX_PARTS:
        raise StudyError(f"key '{shortened(key)}' has {len(parts)} parts; at most {MAX_PARTS} lead somewhere.")
    place = data
    for i, part in enumerate(parts):
        at: Any = part
        if isinstance(place, list):
            at = _entry(place, part, ".".join(parts[:i]))
        elif not isinstance(place, dict):
            raise StudyError(f"key '{key}': {'.'.join(parts[:i])} is no table. Check the key.")
        elif i < len(parts) - 1:
            place.setdefault(part, {})
        if i == len(parts) - 1:
            place[at] = value
        else:
            place = place[at]


def _entry(entries: list[Any], part: str, where: str) -> int:
    names = [str(entry.get("name", "")) if isinstance(entry, dict) else "" for entry in entries]
    if part in names:
        return names.index(part)
    if part.isdigit() and int(part) < len(entries):
        return int(part)
    known = ", ".join(filter(None, names)) or f"0 to {len(entries) - 1}"
    raise StudyError(f"{where} has no entry '{part}'; known: {known}.")


def _check_arguments(scenario: str, arguments: Mapping[str, Any]) -> None:
    known = inspect.signature(SCENARIOS[scenario]).parameters
    for name in arguments:
        if name not in known:
            raise UnknownNameError("argument", name, known, f"scenario.{scenario}")


def _flat(tables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys with their lists and ranges: TOML reads `a.b = [1]` as a table a with b."""
    for key, value in tables.items():
        if isinstance(value, dict) and not {"low", "high"} <= set(value):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _values(key: str, given: Any) -> tuple[Any, ...]:
    if isinstance(given, dict):
        try:
            return tuple(RangeTable.model_validate(given).values())
        except ValidationError as error:
            raise StudyError(f"axes: {key}: {explain(error)}") from error
    if not isinstance(given, list) or not 1 <= len(given) <= MAX_VALUES:
        raise StudyError(f"axes: {key}: give a list of 1 to {MAX_VALUES} values, or {{ low, high, number }}.")
    return tuple(given)


def load_study(path: str | Path) -> Study:
    """Read and check a study file (TOML or YAML). Nothing is run.

    Raises:
        StudyError: the file breaks the schema, an axis leads nowhere, or a value breaks the schema of cell files.
        CellFileError: a file is missing, too large, or neither TOML nor YAML.
    """
    file = Path(path)
    try:
        made = _study(StudyFile.model_validate(read_tables(file)), folder_of(file))
        _check(made)
    except ValidationError as error:
        raise StudyError(f"{file}: {explain(error)}") from error
    except StudyError as error:
        raise StudyError(f"{file}: {error}") from error
    return made


def _study(file: StudyFile, folder: Path) -> Study:
    base: dict[str, Any] = {}
    if file.cell is not None:
        cell_file = resolve(file.cell, folder, "cell")
        base = read_tables(cell_file)
        folder = folder_of(cell_file)
    elif file.scenario not in SCENARIOS:
        raise StudyError(str(UnknownNameError("scenario", str(file.scenario), SCENARIOS)))
    whole = {**base, "disturbances": copy.deepcopy(file.disturbances)}
    for key, value in file.set.items():
        put(whole, key, value)
    disturbed = whole.pop("disturbances")
    if not isinstance(disturbed, dict):
        raise StudyError(f"set: disturbances: give a table, not {shown(disturbed)}.")
    return Study(
        name=file.name,
        base=whole,
        folder=str(folder.absolute()),
        scenario=file.scenario or "",
        cases=tuple((case.name, case.set) for case in file.cases),
        axes=tuple((key, _values(key, given)) for key, given in _flat(file.axes)),
        disturbances=disturbed,
        draws=file.draws,
        repeats=file.repeats,
        seed=file.seed,
        timeout_s=file.timeout_s,
        figures=tuple(file.figures),
    )


def _check(study: Study) -> None:
    """Check each value of each axis and each case against the schema."""
    if len(study) > MAX_ROWS:
        raise StudyError(f"{len(study)} rows; at most {MAX_ROWS} are run. Take fewer values.")
    for name in study.figures:
        if name not in FIGURES:
            raise StudyError(str(UnknownNameError("column", name, FIGURES, "figures")))
    if len({name for name, _ in study.cases}) < len(study.cases):
        raise StudyError("cases: two of them have the same name. Give each its own.")
    first = dict(study.row(0).values)
    tries: list[tuple[str, dict[str, Any]]] = [("", first)]
    tries += [(f"case '{name}': ", {**first, "case": name}) for name, _ in study.cases[1:]]
    tries += [(f"axis {key}: ", {**first, key: value}) for key, values in study.axes for value in values[1:]]
    for where, values in itertools.islice(tries, MAX_VALUES):
        try:
            study.settings(values)
        except CoopqpError as error:
            raise StudyError(f"{where}{error}") from error


#: Instructions that change the order of additions, in NumPy, its libraries or the compiled core.
_SIMD = ("AVX2", "FMA3", "AVX512F", "NEON")


def _has(instructions: str) -> bool:
    features = getattr(getattr(getattr(np, "_core", None), "_multiarray_umath", None), "__cpu_features__", {})
    return bool(features.get(instructions, False))


def versions() -> dict[str, str]:
    """The bits of a row depend on these: versions, the solver, the processor."""
    import platform

    from coopqp.solvers.choice import default_solver

    packages = ("pin", "numpy", "scipy", "daqp", "osqp", "proxsuite")
    return {
        "python": platform.python_version(),
        "coopqp": __version__,
        **{name: metadata.version(name) for name in packages},
        "solver": str(default_solver()),
        "processor": f"{platform.machine()} {' '.join(name for name in _SIMD if _has(name))}".strip(),
    }
