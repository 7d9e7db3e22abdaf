"""The size of the package and of what it repeats: ``python tests/count.py``, or ``--json FILE``.

The rules:

* A line of code has something else on it than comments and docstrings. Python and native code count alike; stubs count.
* The glue only carries data between Python and the compiled core: the files of ``GLUE``.
  The numerical part is the rest of the native code.
* A constant of the core (``coopqp/core/constants.h``) stands twice if a Python module has a literal of its
  value at the top of the module or of a class, under the constant's name with or without underscores before it, or
  under a name of ``ALIASES``.
* The names at the top are those of ``coopqp.__all__``.
* An import points up if it is of a package that the contract in ``pyproject.toml`` does not allow. Imports in
  functions, for types only and by ``import_module`` with a fixed name count. Each pair of modules counts once.
* A circle is a set of modules that import each other, directly or through others. Packages that hand out names of
  their modules on first use (their stubs) import those modules. Python runs circles only because some of their
  imports come late, in functions or for types: these are listed.
"""

from __future__ import annotations

import argparse
import ast
import functools
import io
import json
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
#: Endings of native code.
NATIVE = (".c", ".h", ".cpp", ".hpp")
#: Where the constants of the core are listed.
CONSTANTS = "coopqp/core/constants.h"
#: Files that only carry data to and from the compiled core.
GLUE = (
    "coopqp/control/core/__init__.py",
    "coopqp/control/core/loop.py",
    "coopqp/control/core/force_memory.py",
    "coopqp/control/core/memory.py",
    "coopqp/core/__init__.py",
    "coopqp/core/binding/arrays.h",
    "coopqp/core/binding/constants.cpp",
    "coopqp/core/binding/module.cpp",
    "coopqp/core/binding/distances.cpp",
    "coopqp/core/binding/guards.h",
    "coopqp/core/binding/kinematics.cpp",
    "coopqp/core/binding/structs.cpp",
    "coopqp/core/binding/step.cpp",
)
#: Other names of the core's constants in Python.
ALIASES = {
    "AT_REST": "_STILL", "CHANGE_SHARE": "_SHARE", "DRIFT_FLOOR": "_FLOOR", "DRIFT_PERIOD": "_PERIOD",
    "DRIFT_SAMPLE": "_SAMPLE", "FASTEST_JOINT": "_FASTEST", "LARGEST_X": "REACH", "RATE_TOLERANCE": "_ROUNDING",
    "SERVOS_SETTLED": "_SETTLED", "SHORTEST_CHANGE": "_SHORTEST", "STILL_COMMAND": "_STILL",
    "STILL_OBJECT": "AT_REST", "STILL_SLOPE": "_STILL",
}  # fmt: skip
_NOT_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip

Imports = dict[str, set[str]]


# -- lines -------------------------------------------------------------------------------------------------------------


class Module(NamedTuple):
    """A parsed module, and its nodes that are looked at again and again."""

    tree: ast.Module
    documented: list[ast.AST]
    classes: list[ast.ClassDef]
    imports: list[ast.AST]  # calls, too


@functools.cache
def parsed(text: str) -> Module:
    """A module from its text."""
    module = Module(ast.parse(text), [], [], [])
    for node in ast.walk(module.tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            module.documented.append(node)
        if isinstance(node, ast.ClassDef):
            module.classes.append(node)
        elif isinstance(node, (ast.Import, ast.ImportFrom, ast.Call)):
            module.imports.append(node)
    return module


def python_lines(text: str) -> set[int]:
    """Numbers of the lines of code."""
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NOT_CODE:
            found.update(range(token.start[0], token.end[0] + 1))
    for node in parsed(text).documented:
        for first in getattr(node, "body", [])[:1]:
            if isinstance(first, ast.Expr) and isinstance(getattr(first.value, "value", None), str):
                found.difference_update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return found


def native_lines(text: str) -> int:
    """How many lines of C or C++ have code."""
    pattern = r'"(?:\\.|[^"\\\n])*"|//[^\n]*|/\*.*?\*/'
    code = re.sub(pattern, lambda m: "''" if m[0].startswith('"') else "\n" * m[0].count("\n"), text, flags=re.DOTALL)
    return sum(bool(line.strip()) for line in code.splitlines())


def lines_of(file: Path) -> int:
    """Lines of code of a file."""
    text = file.read_text(encoding="utf-8")
    return native_lines(text) if file.suffix in NATIVE else len(python_lines(text))


def _module(file: Path) -> Module:
    return parsed(file.read_text(encoding="utf-8"))


def sources(root: Path) -> list[Path]:
    """Source files of the package."""
    endings = (".py", ".pyi", *NATIVE)
    return sorted(file for file in (root / "coopqp").rglob("*") if file.suffix in endings)


def package_lines(root: Path) -> dict[str, dict[str, int]]:
    """Lines of code by package, in Python and native."""
    found: dict[str, Counter[str]] = {}
    for file in sources(root):
        place = file.relative_to(root / "coopqp").parts
        package = place[0] if len(place) > 1 else "top"
        found.setdefault(package, Counter())["native" if file.suffix in NATIVE else "python"] += lines_of(file)
    return {package: dict(lines) for package, lines in found.items()}


def glue_lines(root: Path) -> dict[str, int]:
    """Lines of the glue, file by file."""
    return {name: lines_of(file) for name in GLUE if (file := root / name).is_file()}


# -- constants ---------------------------------------------------------------------------------------------------------


def _assigned(body: list[ast.stmt]) -> Iterator[tuple[str, ast.expr]]:
    """Names and what is assigned to them."""
    for statement in body:
        if isinstance(statement, ast.AnnAssign) and statement.value:
            targets: list[ast.expr] = [statement.target]
            value = statement.value
        elif isinstance(statement, ast.Assign):
            targets, value = statement.targets, statement.value
        else:
            continue
        for target in targets:
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = [*zip(target.elts, value.elts, strict=True)]
            else:
                pairs = [(target, value)]
            yield from ((name.id, one) for name, one in pairs if isinstance(name, ast.Name))


def _number(node: ast.expr) -> float | None:
    """Value of an expression of numbers alone."""
    allowed = (ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
    if not all(isinstance(part, allowed) for part in ast.walk(node)):
        return None
    value = eval(compile(ast.Expression(node), "constant", "eval"))
    return value if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def core_constants(root: Path) -> dict[str, float]:
    """The constants that several files of the core share, or Python, too."""
    found = dict[str, float]()
    for name, value in re.findall(
        r"^constexpr \w+ (\w+) = (.+?);", (root / CONSTANTS).read_text("utf-8"), re.MULTILINE
    ):
        found[name] = eval(value, {}, found)
    return found


def constants_twice(root: Path) -> dict[str, list[str]]:
    """Constants of the core that stand in Python modules as well, and in which."""
    constants, found = core_constants(root), dict[str, list[str]]()
    for file in sources(root):
        if file.suffix != ".py":
            continue
        module = _module(file)
        scopes: list[ast.Module | ast.ClassDef] = [module.tree, *module.classes]
        for scope in scopes:
            for name, node in _assigned(scope.body):
                for constant, value in constants.items():
                    same_name = name.lstrip("_") == constant or name == ALIASES.get(constant)
                    if same_name and _number(node) == value:
                        found.setdefault(constant, []).append(f"{file.relative_to(root)}: {name}")
    return found


# -- names and imports -------------------------------------------------------------------------------------------------


def top_names(root: Path) -> list[str]:
    """Public names at the top of the package, as its stub lists them; modules are none."""
    tree = _module(root / "coopqp" / "__init__.pyi").tree
    found = [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.module]
    return sorted(alias.name for node in found for alias in node.names)


def modules(root: Path) -> dict[str, Path]:
    """Modules by name; packages are modules, too."""
    files = (file for file in sources(root) if file.suffix == ".py")
    return {".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): file for file in files}


def imports(root: Path) -> Imports:
    """The modules that each module imports, at once, in functions or for types; of all but the top of the package."""
    known = modules(root)
    found: Imports = {}
    for name, file in known.items():
        if name == "coopqp":
            continue
        found[name] = {one for node in _module(file).imports for one in _imported(node, known)} - {name}
        found[name] |= _handed_out(name, file.with_suffix(".pyi"), known)
    return found


def _handed_out(name: str, stub: Path, known: dict[str, Path]) -> set[str]:
    """The modules whose names a package hands out on first use: those that its stub lists."""
    if stub.name != "__init__.pyi" or not stub.is_file():
        return set()
    listed = (node for node in _module(stub).tree.body if isinstance(node, ast.ImportFrom))
    return known.keys() & {f"{name}.{node.module}" for node in listed}


def _imported(node: ast.AST, known: dict[str, Path]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in known)
    elif isinstance(node, ast.ImportFrom) and node.module in known and not node.level:
        for alias in node.names:
            below = f"{node.module}.{alias.name}"
            yield below if below in known else node.module
    elif isinstance(node, ast.Call) and isinstance(node.func, (ast.Name, ast.Attribute)):
        called = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
        if called == "import_module" and node.args and isinstance(node.args[0], ast.Constant):
            yield from known.keys() & {node.args[0].value}


def order(root: Path) -> dict[str, tuple[int, str]]:
    """Level of each package of the contract, 0 at the bottom, and what stands beside it there."""
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    with (root / "pyproject.toml").open("rb") as stream:
        contracts = tomllib.load(stream)["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    return {
        package.strip("() "): (level, layer)
        for level, layer in enumerate(reversed(layers))
        for package in re.split(r"[:|]", layer)
    }


def upward(root: Path, graph: Imports) -> list[tuple[str, str]]:
    """Imports that the order of the packages does not allow."""
    levels = order(root)

    def allowed(a: str, b: str) -> bool:
        (level, layer), (other, _) = levels[a], levels[b]
        return a == b or other < level or (other == level and ":" in layer)

    return sorted(
        (name, other)
        for name, others in graph.items()
        for other in others
        if other == "coopqp" or not allowed(name.split(".")[1], other.split(".")[1])
    )


def late_imports(root: Path, circle: list[str], graph: Imports) -> list[tuple[str, str]]:
    """Imports within a circle that are not run when their module is loaded."""
    known = modules(root)
    found = []
    for name in circle:
        at_once = {one for node in _at_once(_module(known[name]).tree.body) for one in _imported(node, known)}
        found += [(name, other) for other in sorted(graph[name] & set(circle)) if other not in at_once]
    return found


def _at_once(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Imports that are run when a module is loaded."""
    for node in body:
        if isinstance(node, ast.If):
            yield from _at_once(node.orelse if "TYPE_CHECKING" in ast.unparse(node.test) else node.body + node.orelse)
        elif isinstance(node, ast.Try):
            yield from _at_once(node.body + node.orelse)
        else:
            yield node


def circles(graph: Imports) -> list[list[str]]:
    """Sets of modules that import each other, directly or through others (Tarjan)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(name: str) -> None:
        number[name] = lowest[name] = len(number)
        stack.append(name)
        for other in sorted(graph.get(name, ())):
            if other not in number:
                visit(other)
                lowest[name] = min(lowest[name], lowest[other])
            elif other in stack:
                lowest[name] = min(lowest[name], number[other])
        if lowest[name] == number[name]:
            at = stack.index(name)
            if len(stack) - at > 1:
                found.append(sorted(stack[at:]))
            del stack[at:]

    for name in sorted(graph):
        if name not in number:
            visit(name)
    return sorted(found, key=len)


# -- together ----------------------------------------------------------------------------------------------------------


def figures(root: Path = ROOT) -> dict[str, Any]:
    """Everything that is counted."""
    packages, glue, graph = package_lines(root), glue_lines(root), imports(root)
    around = circles(graph)
    native = sum(lines.get("native", 0) for lines in packages.values())
    glue_native = sum(lines for name, lines in glue.items() if name.endswith(NATIVE))
    return {
        "lines": sum(sum(lines.values()) for lines in packages.values()),
        "native lines": native,
        "numerical native lines": native - glue_native,
        "lines by package": packages,
        "glue lines": sum(glue.values()),
        "glue by file": glue,
        "constants": len(core_constants(root)),
        "constants twice": constants_twice(root),
        "names at the top": len(top_names(root)),
        "imports upwards": upward(root, graph),
        "circles": around,
        "late imports in circles": [late_imports(root, circle, graph) for circle in around],
    }


def text(found: dict[str, Any]) -> str:
    """The figures as lines to read."""
    lines = [f"{'lines of code':38}{found['lines']:7}"]
    for package, parts in sorted(found["lines by package"].items(), key=lambda one: -sum(one[1].values())):
        native = f"  ({parts['native']} native)" if "native" in parts else ""
        lines.append(f"    {package:34}{sum(parts.values()):7}{native}")
    lines += [
        f"{'numerical native code':38}{found['numerical native lines']:7}",
        f"{'glue of the core':38}{found['glue lines']:7}",
        *(f"    {name:34}{size:7}" for name, size in found["glue by file"].items()),
        f"{'constants of the core that stand twice':38}{len(found['constants twice']):7}  of {found['constants']}",
        f"{'names at the top of coopqp':38}{found['names at the top']:7}",
        f"{'imports upwards':38}{len(found['imports upwards']):7}",
        *(f"    {name} -> {other}" for name, other in found["imports upwards"]),
        f"{'circles of imports':38}{len(found['circles']):7}",
    ]
    for circle, late in zip(found["circles"], found["late imports in circles"], strict=True):
        lines.append(f"    {len(circle)} modules, {', '.join(circle[:4])}{', ...' if len(circle) > 4 else ''}; late:")
        lines += [f"        {name} -> {other}" for name, other in late]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=ROOT, help="another checkout")
    parser.add_argument("--json", type=Path, help="file for all figures")
    options = parser.parse_args(arguments)
    found = figures(options.root)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(text(found))


if __name__ == "__main__":
    main()
