"""I10: whatever stands in a cell file, the result is a run that can be built or one named error.

Every key of the schema gets every kind of nonsense, alone and several at once. Files are read and built, not run. The
error has one line, names the file, speaks of keys of the file and not of Python, and prints no control characters;
nothing is printed, no warning is raised, and nothing is written.
"""

from __future__ import annotations

import contextlib
import copy
import re
import types
import typing
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel
from ruamel.yaml import YAML

from coopqp import load_cell_file
from coopqp.cli.runs import output_folder
from coopqp.errors import OutputError, StartWarning
from coopqp.files import CellFileError
from coopqp.files.cellfile.schema import CellFile

#: Parts that the files are spread over, so that several processes can share them.
PARTS = 5
FILES = 5_000

BASE: dict[str, Any] = {
    "name": "fuzz",
    "arms": [{"name": "a", "robot": "arm5", "geometry": False}],
    "grasp": {"kind": "latched"},
    "path": {"kind": "hold", "pose": {"xyz_m": [0.5, 0.0, 0.3]}, "duration_s": 1.0},
    "start": {"positions_deg": {"a": [0.0, 10.0, 115.0, -35.0, 0.0]}},
}
#: Other tables that hold at the same start, so that every kind of every table is reached.
VARIANTS: dict[str, list[Any]] = {
    "grasp": [
        {"kind": "triangle", "alpha_m": 0.6, "beta_m": 0.3},
        {"kind": "tools", "tools": {"a": {"rpy_deg": [0.0, 90.0, 0.0]}}},
    ],
    "path": [
        {"kind": "line", "start": {}, "goal": {"xyz_m": [0.0, 0.0, 0.1]}, "duration_s": 1.0},
        {"kind": "line", "start": {}, "displacement": {"translation_m": [0.0, 0.0, 0.1]}, "duration_s": 1.0},
        {"kind": "waypoints", "poses": [{}, {"xyz_m": [0.0, 0.0, 0.1]}], "durations_s": [1.0]},
    ],
    "controller": [
        {"kind": "qp", "common_error": {"kind": "leaderless"}},
        {"kind": "pseudo_inverse"},
        {"kind": "independent"},
    ],
    "plant": [{"kind": "kinematic"}, {"kind": "physics"}],
    "collision": [
        {
            "carried": [{"name": "ball", "shape": "sphere", "radius_m": 0.02}],
            "obstacles": [
                {"name": "post", "shape": "capsule", "radius_m": 0.05, "length_m": 1.0, "at": {"xyz_m": [3, 0, 0]}}
            ],
            "on_links": [{"name": "hand", "link": "a/link_5", "shape": "box", "size_m": [0.02, 0.02, 0.02]}],
            "margins": [{"between": ["ball", "post"], "margin_m": 0.02}],
        },
    ],
}
NUMBERS = (
    0,
    -1,
    1,
    2.5,
    1e300,
    -1e300,
    1e-300,
    1e308,
    5e-324,
    float("nan"),
    float("inf"),
    -float("inf"),
    2**63,
    10**40,
)
TEXTS = (
    "", " ", "a", "a/b", "..", "../../x", "/dev/null", "/etc", "~", "~nobody/x", "$HOME", "$NO_SUCH", "${", "package://",
    "package://x/y", "robot.txt", "folder", "x.urdf.xacro", "=cmd()", "-1", "1.5", "nan", "true", "None", "{}", "%s{0}",
    "\x1b[2J", "a\nb", "a\x00b", "\u202eabc", "\ud800"[:0] + "é", "x" * 101, "y" * 5000, "qp", "panda", "leaderless",
)  # fmt: skip
OTHERS = (None, True, False, [], {}, [[]], [None], [1, 2, 3], [1e308] * 3, ["a"] * 3, {"a": 1}, {"kind": "x"}, {"": {}})
NONSENSE: tuple[Any, ...] = (
    *NUMBERS,
    *TEXTS,
    *OTHERS,
    [0.0] * 200,
    [[0.0] * 4] * 4,
    np.eye(4).tolist(),
    {"a": [1e9] * 5},
)
#: Values of a size that the schema accepts somewhere: these reach the models, the kinematics and the controller.
PLAUSIBLE: tuple[Any, ...] = (
    1e-6, 1e-3, 0.002, 0.01, 0.05, 0.1, 0.5, 1.0, 2, 3, 5.0, 20.0, 90.0, 1e3, 1e4, 1e6, -0.5, -90.0, True, False, "a",
    "tool", "link_3", "auto", "daqp", "full", "midpoint", [0.1] * 3, [0.5] * 5, [-1e4] * 3, [90.0] * 5, [1e6] * 5,
    [1e-3] * 2, {"joint_2": 0.3}, {"joint_5": 90.0, "joint_4": 1e6}, {"a": [0.0, 10.0, 115.0, -35.0, 0.0]},
    {"a": [1e6] * 5}, {"xyz_m": [0.5, 0.1, 0.3], "rpy_deg": [10.0, 20.0, 30.0]}, [{}, {"rpy_deg": [0.0, 0.0, 180.0]}],
    [0.5, 2.0],
)  # fmt: skip
#: Words of Python that a user of files must not be told.
PYTHON = re.compile(
    r"coopqp\.|np\.|numpy|pinocchio|\bpin\b|\w+Options|JointLimits|RankWeights|LinePath|WaypointPath|HoldPath|Arm\.|"
    r"from_urdf|T_world|\bSE3\b|None\b|\bTrue\b|\bFalse\b|=\s*\w+\(|\w+\(…\)|(?<!torque)_limits\b|dataclass|Traceback|keyword|"
    r"\w+Error\b|object at 0x|\w+Settings\b|\bdict(ionary)?\b|\btuple\b|\bfloat\b|\bint\b|\bstr\b"
)


def keys(table: type[BaseModel]) -> Iterator[tuple[str, ...]]:
    """Every key of a table and of the tables in it, as a path."""
    for name, field in table.model_fields.items():
        yield (name,)
        for inner in _tables(field.annotation):
            for path in keys(inner):
                yield (name, *path)


def _tables(kind: Any) -> Iterator[type[BaseModel]]:
    if typing.get_origin(kind) is None and isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind  # to Python 3.10 list[int] is a type, too
    elif not isinstance(kind, types.GenericAlias) or typing.get_args(kind):
        for member in typing.get_args(kind):
            yield from _tables(member)


def put(data: Any, path: tuple[str, ...], value: Any) -> None:
    """Put a value at a path; lists are entered at their first entry, tables by arm at the arm's."""
    for key in path[:-1]:
        inner = data.get(key)
        if isinstance(inner, list) and inner and isinstance(inner[0], dict):
            inner = inner[0]
        elif not isinstance(inner, dict):
            inner = data[key] = {}
        if path[-1] in ("xyz_m", "rpy_deg", "rpy_rad", "matrix") and key == "tools":
            inner = inner.setdefault("a", {})
        if not isinstance(inner, dict):  # earlier nonsense
            return
        data = inner
    data[path[-1]] = value


def written(value: Any) -> Any:
    """A value that YAML can hold."""
    return [written(v) for v in value] if isinstance(value, tuple) else value


def toml(value: Any) -> str:
    """A value in the notation of TOML, tables inline."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return '"' + "".join(f"\\U{ord(c):08x}" if not c.isalnum() else c for c in value) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(toml(v) for v in value if v is not None) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(str(k))} = {toml(v)}" for k, v in value.items() if v is not None) + "}"
    return '"?"'


def files(rng: np.random.Generator, part: int, number: int) -> Iterator[tuple[dict[str, Any], str]]:
    """Cell files, each with the place of its nonsense. Every key of the schema comes up in every part."""
    places = list(dict.fromkeys(keys(CellFile)))
    for i in range(number):
        data = copy.deepcopy(BASE)
        # Each key in turn; the nonsense that it gets moves on from round to round and from part to part.
        path = places[i % len(places)]
        turn = (i // len(places)) * PARTS + part
        for name, variants in VARIANTS.items():
            wanted = [v for v in variants if name == path[0] and (len(path) < 2 or path[1] in v)]
            if path[0] == name or rng.uniform() < 0.2:
                choice = wanted or variants
                data[name] = copy.deepcopy(choice[int(rng.integers(len(choice)))])
        values = PLAUSIBLE if rng.uniform() < 0.6 else NONSENSE
        put(data, path, copy.deepcopy(values[(7 * (i % len(places)) + turn) % len(values)]))
        for _ in range(int(rng.integers(0, 3)) if rng.uniform() < 0.3 else 0):
            other = places[int(rng.integers(len(places)))]
            put(data, other, copy.deepcopy(NONSENSE[int(rng.integers(len(NONSENSE)))]))
        yield data, ".".join(path)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory and home, beside a folder of odd files."""
    here = tmp_path / "here"
    here.mkdir()
    for name in ("cells", "cells/folder", "home"):
        (tmp_path / name).mkdir()
    (tmp_path / "cells" / "robot.txt").write_text("no robot")
    (tmp_path / "cells" / "x.urdf.xacro").write_text('<robot name="r"/>')
    monkeypatch.chdir(here)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("part", range(1, PARTS + 1))
def test_every_cell_file_is_built_or_refused_by_name(
    part: int,
    folder: Path,
    count: Callable[[int], int],
    catalogue: Any,
    rng: np.random.Generator,
    capfd: pytest.CaptureFixture[str],
) -> None:
    found: Counter[str] = Counter()
    examples: dict[str, str] = {}
    built = tried = 0
    before = set(folder.rglob("*"))
    for data, place in files(rng, part, count(FILES // PARTS)):
        as_yaml = bool(rng.uniform() < 0.1)
        file = folder / "cells" / ("cell.yaml" if as_yaml else "cell.toml")
        if as_yaml:
            with file.open("w", encoding="utf-8") as stream:
                YAML(typ="safe", pure=True).dump(written(data), stream)
        else:
            file.write_text("\n".join(f"{toml(k)} = {toml(v)}" for k, v in data.items() if v is not None), "utf-8")
        wrong = ""
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", StartWarning)  # in words of coopqp: the start is far from the file's
            try:
                run = load_cell_file(file)
                out = run.settings.output
                built += 1
                with contextlib.suppress(OutputError):
                    target = output_folder(run.scenario.name, out.folder, ["recording"], out=None, force=True)
                    if not target.resolve().is_relative_to(Path.cwd()):
                        wrong, text = "written outside the folder", str(target)
            except CellFileError as error:
                text = str(error)
                head, _, said = text.partition(f"{file}")
                if head or not said or "\n" in text or len(text) > 3000:
                    wrong = "no single line that begins with the file"
                elif any(c < " " or c in "\x7f\u202e" for c in text):
                    wrong = "control characters"
                elif python := PYTHON.search(re.sub(r"'[^'…]*…'?|'[^']*'|Available: .*", "", said)):  # of its own
                    wrong = f"a word of Python, {python[0]}"
            except Exception as error:
                text = f"{type(error).__name__}: {error}"
                wrong = "no CellFileError"
        printed = "".join(capfd.readouterr())
        if printed:
            wrong, text = wrong or "printed", printed
        file.unlink()
        tried += 1
        if wrong:
            found[wrong] += 1
            examples.setdefault(f"{wrong}: {text[:60]}", f"{place}: {text[:400]}")
    left = set(folder.rglob("*")) - before
    catalogue.row(
        "I10",
        f"schema fuzz, files that end in a traceback, a raw warning or a word of Python: {part} of {PARTS}",
        cases=tried,
        measured=found.total() + len(left),
        target=0,
        note=f"every key, every kind of nonsense; {built:,} files could be built",
    ) if not found else pytest.fail("\n".join(f"{v}" for v in list(examples.values())[:60]) + f"\n{found}")
    assert built > 0.02 * tried
