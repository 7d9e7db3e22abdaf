"""The names that users import: complete, sorted, importable without extras, and imported from one place."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import coopqp

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "coopqp"
ROOMS = (
    "model", "task", "planning", "control", "collision", "forces", "simulation", "scenarios", "files", "studies",
    "look", "app",
)  # fmt: skip
PUBLIC = ("coopqp", *(f"coopqp.{room}" for room in ROOMS if room != "app"))
#: Packages with names that are imported on first use.
LAZY = (
    "coopqp",
    "coopqp.collision",
    "coopqp.control",
    "coopqp.forces",
    "coopqp.simulation",
    "coopqp.files",
    "coopqp.visualization",
    "coopqp.planning",
    "coopqp.studies",
)
#: Scripts that measure the parts of a step.
INSIDE = (
    "benchmarks/peer",
    "benchmarks/collisions.py",
    "benchmarks/compare_peers.py",
    "benchmarks/look_ahead_cases.py",
    "benchmarks/planning.py",
    "benchmarks/recorded_qps.py",
    "benchmarks/step_profile.py",
)
EXTRAS = (
    "matplotlib", "rich", "mujoco", "viser", "example_robot_data", "rosbags", "pydantic", "ruamel", "quadprog",
    "joblib", "distributed", "pyarrow",
)  # fmt: skip


def source_of(package: str) -> ast.Module:
    return ast.parse((ROOT / package.replace(".", "/") / "__init__.py").read_text(encoding="utf-8"))


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


@pytest.mark.parametrize(
    "package",
    [
        "coopqp",
        "coopqp.control",
        "coopqp.simulation",
        "coopqp.files",
        "coopqp.scenarios",
        "coopqp.planning",
        "coopqp.forces",
        "coopqp.studies",
    ],
)
def test_names_are_sorted_and_importable(package: str) -> None:
    module = importlib.import_module(package)
    names = module.__all__
    assert names == sorted(set(names))
    for name in names:
        assert getattr(module, name) is not None
        assert name in dir(module)
    with pytest.raises(AttributeError, match="no_such_name"):
        module.no_such_name  # noqa: B018


@pytest.mark.parametrize("package", LAZY)
def test_type_checkers_and_the_running_package_find_a_name_in_the_same_module(package: str) -> None:
    (branch,) = (node for node in source_of(package).body if isinstance(node, ast.If))
    typed = {(name, module) for module, name in imports(ast.Module(branch.body, []))}
    (table,) = (node for node in ast.walk(ast.Module(branch.orelse, [])) if isinstance(node, ast.Dict))
    places: dict[str, str] = ast.literal_eval(table)
    assert {(name, module) for module, names in places.items() for name in names.split()} == typed


@pytest.mark.parametrize("package", LAZY)
def test_every_imported_name_is_listed(package: str) -> None:
    imported = {name for _, name in imports(source_of(package))} - {"lazy_names"}
    assert imported | {"__version__"} == {*importlib.import_module(package).__all__, "__version__"}


def test_no_public_name_is_that_of_a_module() -> None:
    """An import of the module would put it in the place of the name."""
    for package in (*LAZY, "coopqp.visualization"):
        folder = ROOT / package.replace(".", "/")
        modules = {file.stem for file in folder.glob("*.py")} | {
            file.name for file in folder.iterdir() if file.is_dir()
        }
        assert modules.isdisjoint(importlib.import_module(package).__all__), package


def test_errors_and_options_are_all_public() -> None:
    """A user can catch every error, set every option, and name the type of every option."""
    for file in sorted(PACKAGE.rglob("*.py")):
        room = file.relative_to(PACKAGE).parts[0]
        if room == "app":
            continue
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                if node.name.endswith(("Error", "Options", "Plant")):
                    assert node.name in coopqp.__all__, file
                if node.name.endswith("Settings"):
                    assert node.name in coopqp.__all__, file


def test_types_in_signatures_of_public_functions_are_public() -> None:
    """What a public function takes or returns can be named by its user."""
    known = {
        *coopqp.__all__,
        *importlib.import_module("coopqp.collision").__all__,
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
            listed = importlib.import_module(module).__all__
            assert imported in listed, f"{name}: from {module} import {imported}"


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
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr


def test_importing_coopqp_leaves_files_pictures_and_engines_alone() -> None:
    code = "import sys, coopqp; print(*sorted(name for name in sys.modules if name.startswith('coopqp.')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    rooms = {name.split(".")[1] for name in done.stdout.split()}
    assert rooms.isdisjoint({"files", "studies", "look", "app"})
    assert "coopqp.simulation.plants.physics" not in done.stdout.split()


def test_options_are_frozen_and_given_by_name() -> None:
    """Settings, weights and tolerances of a user cannot be changed under a controller, nor mixed up by their order."""
    found = 0
    for name in coopqp.__all__:
        options = getattr(coopqp, name)
        if not dataclasses.is_dataclass(options) or not name.endswith(("Options", "Settings", "Weights")):
            continue
        found += 1
        made = options()
        for field in dataclasses.fields(options):
            assert field.kw_only, f"{name}.{field.name}"
            with pytest.raises(dataclasses.FrozenInstanceError):
                setattr(made, field.name, getattr(made, field.name))
    assert found >= 10
