"""The names that users import: complete, sorted, importable without extras, and imported from one place."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
from collections.abc import Iterator

import pytest
from places import ROOT
from processes import output

import coopqp

PACKAGE = ROOT / "coopqp"
#: Packages whose names a stub lists, imported on first use.
LAZY = (
    "coopqp",
    *(
        f"coopqp.{package}"
        for package in (
            "baselines", "collision", "constraints", "control", "drivers", "files", "forces", "model", "paths",
            "planning", "programs", "simulation", "solvers", "studies", "visualization",
        )
    ),
)  # fmt: skip
#: Modules whose own functions and classes are public.
MODULES = ("coopqp.errors", "coopqp.output", "coopqp.spatial")
PUBLIC = (*LAZY, *MODULES, "coopqp.scenarios")
#: Scripts that measure the parts of a step, and judges that stand where a robot or a stranger does.
INSIDE = (
    "benchmarks/behaviour.py",
    "benchmarks/peer",
    "benchmarks/collisions.py",
    "benchmarks/compare_peers.py",
    "benchmarks/drive_cases.py",
    "benchmarks/drive_peers.py",
    "benchmarks/drive_runs.py",
    "benchmarks/drive_shared.py",
    "benchmarks/look_ahead_cases.py",
    "benchmarks/ompl_routes.py",
    "benchmarks/planning.py",
    "benchmarks/promise_cases/real_robots.py",
    "benchmarks/promise_cases/strangers.py",
    "benchmarks/recorded_qps.py",
    "benchmarks/step_profile.py",
)
EXTRAS = (
    "matplotlib", "rich", "mujoco", "viser", "example_robot_data", "rosbags", "pydantic", "ruamel", "quadprog",
    "joblib", "distributed", "pyarrow",
)  # fmt: skip


def public_names(package: str) -> list[str]:
    module = importlib.import_module(package)
    if package not in MODULES:
        return list(module.__all__)
    return [name for name, thing in vars(module).items() if not name.startswith("_") and name[0].isalpha() and (
        getattr(thing, "__module__", "") == package or name in ("Array", "Placement"))]  # fmt: skip


def imports(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Module and name of every ``from coopqp… import name``; an empty name for ``import coopqp…``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "coopqp":
            yield from ((node.module or "", alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.split(".")[0] == "coopqp")


def programs() -> dict[str, str]:
    """Everything that users read as an example: Python files, and the Python blocks of the pages."""
    found = {}
    for folder in ("docs/examples", "benchmarks"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            name = file.relative_to(ROOT).as_posix()
            if not name.startswith(INSIDE):
                found[name] = file.read_text(encoding="utf-8")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        blocks = re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        found[page.relative_to(ROOT).as_posix()] = "\n".join(blocks)
    return found


PROGRAMS = programs()


@pytest.mark.parametrize("package", [*LAZY, "coopqp.scenarios"])
def test_names_are_importable(package: str) -> None:
    module = importlib.import_module(package)
    names = module.__all__
    assert len(names) == len(set(names))
    for name in names:
        assert getattr(module, name) is not None
        assert name in dir(module)
    with pytest.raises(AttributeError, match="no_such_name"):
        module.no_such_name  # noqa: B018


def test_the_top_has_what_most_programs_need() -> None:
    assert len(coopqp.__all__) <= 50


def test_a_name_that_is_not_here_is_said_to_be_there() -> None:
    with pytest.raises(ImportError, match=r"'Disturbances'; it is in coopqp\.simulation"):
        from coopqp import Disturbances  # type: ignore[attr-defined] # noqa: F401
    with pytest.raises(AttributeError, match="Did you mean 'QPController'"):
        coopqp.QPControler  # type: ignore[attr-defined] # noqa: B018
    with pytest.raises(AttributeError, match=r"Did you mean 'Disturbances' of coopqp\.simulation"):
        coopqp.Disturbence  # type: ignore[attr-defined] # noqa: B018
    assert not hasattr(coopqp, "Disturbances")
    assert coopqp.simulation.Disturbances is importlib.import_module("coopqp.simulation").Disturbances


def test_no_public_name_is_that_of_a_module() -> None:
    """An import of the module would put it in the place of the name."""
    for package in LAZY:
        folder = ROOT / package.replace(".", "/")
        modules = {file.stem for file in folder.glob("*.py")} | {
            file.name for file in folder.iterdir() if file.is_dir()
        }
        assert modules.isdisjoint(importlib.import_module(package).__all__), package


def test_errors_and_options_are_all_public() -> None:
    """A user can catch every error, set every option, and name the type of every option."""
    known = {name for package in PUBLIC for name in public_names(package)}
    for file in sorted(PACKAGE.rglob("*.py")):
        room = file.relative_to(PACKAGE).parts[0]
        if room == "cli":
            continue
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            named = node.name if isinstance(node, ast.ClassDef) else "_"
            if not named.startswith("_") and named.endswith(("Error", "Options", "Plant", "Settings")):
                assert named in known, file


def test_types_in_signatures_of_public_functions_are_public() -> None:
    """What a public function takes or returns can be named by its user."""
    known = {
        *(name for package in PUBLIC for name in public_names(package)),
        "Any",
        "ArrayLike",
        "None",
        "Path",
        "Sequence",
        "Mapping",
        "Callable",
        "Literal",
    }
    internal = {"CellRun", "ProgressCallback"}  # returned by load_cell_file, which needs an extra; a plain callable
    for name in coopqp.__all__:
        thing = getattr(coopqp, name)
        if inspect.isfunction(thing):
            named = re.findall(r"\b[A-Z]\w+", " ".join(str(t) for t in thing.__annotations__.values()))
            assert {n for n in named if n not in known and n not in internal and n != "SE3"} == set(), name


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_import_public_names_only(name: str) -> None:
    for module, imported in imports(ast.parse(PROGRAMS[name])):
        assert module in PUBLIC, f"{name}: from {module} import {imported}"
        if imported:
            assert imported in public_names(module), f"{name}: from {module} import {imported}"


@pytest.mark.slow
def test_tests_import_public_names_from_the_public_place() -> None:
    public = {id(getattr(coopqp, name)): name for name in coopqp.__all__}
    deep = []
    for file in sorted((ROOT / "tests").rglob("*.py")):
        for module, name in imports(ast.parse(file.read_text(encoding="utf-8"))):
            if not name or module in PUBLIC:
                continue
            thing = getattr(importlib.import_module(module), name, None)
            if public.get(id(thing)) == name:
                deep.append(f"{file.name}: from {module} import {name}")
    assert deep == []


@pytest.mark.slow
def test_every_public_name_is_there_without_extras() -> None:
    code = f"""
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {EXTRAS!r}:
            raise ImportError(name + " is not installed here")
sys.meta_path.insert(0, Refuse())
from coopqp import *
from coopqp.files import *
"""
    output("-c", code)


def test_importing_coopqp_leaves_files_pictures_and_engines_alone() -> None:
    code = "import sys, coopqp; print(*sorted(name for name in sys.modules if name.startswith('coopqp.')))"
    loaded = output("-c", code).split()
    rooms = {name.split(".")[1] for name in loaded}
    assert rooms.isdisjoint({"files", "studies", "visualization", "cli"})
    assert "coopqp.simulation.plants.physics" not in loaded


def test_options_are_frozen_and_given_by_name() -> None:
    """Settings, weights and tolerances of a user cannot be changed under a controller, nor mixed up by their order."""
    found = 0
    for name, options in sorted(
        {n: getattr(importlib.import_module(p), n) for p in PUBLIC for n in public_names(p)}.items()
    ):
        if not dataclasses.is_dataclass(options) or not name.endswith(("Options", "Settings", "Weights")):
            continue
        found += 1
        made = options()
        for field in dataclasses.fields(options):
            assert field.kw_only, f"{name}.{field.name}"
            with pytest.raises(dataclasses.FrozenInstanceError):
                setattr(made, field.name, getattr(made, field.name))
    assert found >= 10
