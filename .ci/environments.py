"""Make fresh environments of coopqp, and test each: lowest and newest versions, no compiler, the wheels, each extra.

Needs uv beside this Python (extra ``dev``), and writes below ``build/environments``. Downloads are shared between the
environments. Each environment gets a wheel of its own, so that what is tested is what is installed.
"""

from __future__ import annotations

import argparse
import functools
import os
import resource
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from release import NOTES, ROOT, SERVED, STABLE, FailedError, call, note, python_at_hand, sdist, uv, wheels

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FOLDER = ROOT / "build" / "environments"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
#: Extras of users that bring something.
EXTRAS = sorted(
    name
    for name, packages in PROJECT["optional-dependencies"].items()
    if packages and name not in {"all", "dev", "docs", "mutation"}
)
#: The oldest Python that Pinocchio has wheels for, and the newest, or the one before it where that is missing.
OLDEST, NEWEST = ("3.10",), ("3.14", "3.13")
#: The Python that wheels for this one are built on: from 3.12 on one wheel serves all later versions.
HERE = "3.12" if sys.version_info[:2] >= STABLE else f"{sys.version_info[0]}.{sys.version_info[1]}"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Environment:
    """A virtual environment.

    Attributes:
        name: its folder.
        python: versions of Python, as ``3.10``, of which the first at hand is taken; none for the one that runs this.
        extras: extras that are installed.
        options: further options of ``uv pip install``.
        variables: environment variables while coopqp is built.
        source: what is installed: the tree, or a wheel.
    """

    name: str
    python: tuple[str, ...] = ()
    extras: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    variables: tuple[tuple[str, str], ...] = ()
    source: Path = ROOT

    @property
    def bin(self) -> Path:
        """Folder of its programs."""
        return FOLDER / self.name / "bin"

    def make(self) -> None:
        """Make it, anew."""
        print(f"-- {self.name}", flush=True)
        uv("venv", "--quiet", "--clear", "--python", interpreter(*self.python), str(self.bin.parent))
        extras = f"[{','.join(self.extras)}]" if self.extras else ""
        what = f"coopqp{extras} @ {self.source.as_uri()}"
        options = ("--quiet", "--python", str(self.bin / "python"), "--reinstall-package", "coopqp", *self.options)
        uv("pip", "install", *options, what, **dict(self.variables))

    def run(self, *command: str, **variables: str) -> None:
        """Run one of its programs in an empty folder: in the root Python would find the tree, not what is installed."""
        folder = self.bin.parent / "empty"
        folder.mkdir(exist_ok=True)
        call(str(self.bin / command[0]), *command[1:], folder=folder, **ONE_THREAD, **variables)

    def pytest(self, *arguments: str, folders: Sequence[str] = ("",), **variables: str) -> None:
        """Run tests, on all cores: all, or those in folders of ``tests``."""
        tests = (str(ROOT / "tests" / folder) for folder in folders)
        where = ("-c", str(ROOT / "pyproject.toml"), "--rootdir", str(ROOT), *tests)
        spread = ("-n", os.environ.get("WORKERS", "auto"), "--dist", "worksteal")
        self.run("pytest", *where, *spread, "-p", "no:cacheprovider", *arguments, **variables)


def interpreter(*versions: str) -> str:
    """The first of some Pythons that is at hand; this one if there is none. What is missing is said."""
    for version in versions:
        if found := python_at_hand(version):
            return found
        note(f"no Python {version} on this machine: another took its place")
    return sys.executable


#: The source distribution and the wheels that this run has made from it, by the Python of the build.
_MADE: dict[str, Path] = {}


@functools.cache
def distribution() -> Path:
    """Folder with the source distribution, made anew."""
    folder = FOLDER / "dist"
    shutil.rmtree(folder, ignore_errors=True)
    sdist(folder)
    return folder


def wheel(python: str = HERE) -> Path:
    """The wheel that is built on a Python, from the source distribution; as it is released."""
    if python not in _MADE:
        _MADE.update(wheels(distribution(), (python,), tested=False))
    return _MADE[python]


def released(*versions: str) -> tuple[Path, tuple[str, ...]]:
    """The wheel for the first of some Pythons that is at hand, or the tree where none can be built for it.

    Returns also the options of ``uv pip install`` with which everything else has to be a wheel.
    """
    version = next((v for v in versions if python_at_hand(v)), HERE)
    builder = next((b for b, served in SERVED.items() if version in served), HERE)
    if python_at_hand(builder):
        return wheel(builder), ("--only-binary", ":all:")
    return ROOT, ("--only-binary", ":all:", "--no-binary", "coopqp")


# -- the environments ----------------------------------------------------------------------------------------------

#: The tests of make check.
_SOME = ("-m", "not slow", "--hypothesis-profile", "check")
#: Folders with the tests of steps.
_OF_STEPS = ("core", "model", "control", "constraints", "cli")


#: Pages, pictures and benchmarks are made with the versions of the day: with others they would be to no end.
_OTHERS = tuple(f"--ignore={ROOT / 'tests' / folder}" for folder in ("benchmarks", "browser", "project"))


def lowest(tests: list[str]) -> None:
    """The lowest declared version of every dependency, on the oldest Python."""
    constraint = ROOT / ".ci" / "pinocchio-3.txt"
    source, binary = released(*OLDEST)
    options = (*binary, "--resolution", "lowest-direct", "--constraints", str(constraint))
    made = Environment("lowest", OLDEST, ("dev",), options, source=source)
    made.make()
    made.pytest(*tests, *_OTHERS)


_STABLE = """
import sys
from coopqp.core import _core
assert (".abi3." in _core.__file__) == (sys.version_info >= (3, 12)), _core.__file__
"""


def newest(tests: list[str]) -> None:
    """The newest version of every dependency, on the newest Python, with the wheel that is released for it."""
    source, _ = released(*NEWEST)
    made = Environment("newest", NEWEST, ("dev",), ("--upgrade", "--refresh"), source=source)
    made.make()
    made.run("python", "-c", _STABLE)
    made.pytest(*tests, *_OTHERS, folders=_OF_STEPS if tests else ("",))  # make test has the newest versions, too


def no_compiler(_: list[str]) -> None:
    """No compiler on the path: the build takes one from the index, and what it compiles does all that others do."""
    without = (("CC", ""), ("CXX", ""), ("PATH", str(Path(sys.executable).parent)))
    made = Environment("no-compiler", extras=("dev",), variables=without)
    made.make()
    made.run("python", str(ROOT / "tests" / "installed.py"), "all")
    made.pytest(*_SOME, folders=("core", "golden", "cli"))


def release(_: list[str]) -> None:
    """What is released, by the steps of release.yml: wheels for the Pythons at hand, each tested without extras."""
    _MADE.update(wheels(distribution()))
    forms = ROOT / ".github"
    for schema, files in {
        "vendor.github-workflows": sorted(forms.glob("workflows/*.yml")),
        "custom.github-workflows-require-timeout": sorted(forms.glob("workflows/*.yml")),
        "vendor.github-issue-config": [forms / "ISSUE_TEMPLATE" / "config.yml"],
        "vendor.github-issue-forms": [forms / "ISSUE_TEMPLATE" / name for name in ("bug.yml", "idea.yml")],
    }.items():
        uv("tool", "run", "check-jsonschema", "--builtin-schema", schema, *map(str, files))
    named = ("--from", "cibuildwheel>=3,<4", "cibuildwheel", "--print-build-identifiers")
    uv("tool", "run", *named, "--platform", "linux", str(ROOT))


def from_sdist(_: list[str]) -> None:
    """The wheel that is built from the source distribution; the tests meet such a one in newest."""
    made = Environment("from-sdist", extras=("all",), source=wheel())
    made.make()
    made.run("python", str(ROOT / "tests" / "installed.py"), "all")


def extras(_: list[str]) -> None:
    """Each extra alone, and all of them: what needs one. The steps of the release try what needs none."""
    source = wheel()

    def try_one(extra: str) -> None:
        made = Environment(f"extra-{extra}", extras=(extra,), source=source)
        made.make()
        made.run("python", str(ROOT / "tests" / "installed.py"), "--extras", extra)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(try_one, (*EXTRAS, "all")))


ENVIRONMENTS: dict[str, Callable[[list[str]], None]] = {
    "lowest": lowest,
    "newest": newest,
    "no-compiler": no_compiler,
    "release": release,
    "from-sdist": from_sdist,
    "extras": extras,
}


def cpu_seconds() -> float:
    """CPU time of all programs that were run until now."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    """Make and test the environments that are named. Returns 1 if one of them fails."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"environments ({', '.join(ENVIRONMENTS)}; all)")
    parser.add_argument("--some", action="store_true", help="leave out slow tests in lowest and newest, too")
    arguments = parser.parse_args()
    unknown = set(arguments.names) - set(ENVIRONMENTS)
    if unknown:
        parser.error(f"no environment {', '.join(sorted(unknown))}")
    failed, rows = False, []
    for name in arguments.names or ENVIRONMENTS:
        print(f"== {name}: {(ENVIRONMENTS[name].__doc__ or '').splitlines()[0]}", flush=True)
        began, worked, outcome = time.monotonic(), cpu_seconds(), "passed"
        NOTES.clear()
        try:
            ENVIRONMENTS[name](list(_SOME if arguments.some else ()))
        except FailedError as error:
            print(error, flush=True)
            failed, outcome = True, "FAILED"
        times = f"{time.monotonic() - began:5.0f} s, CPU {cpu_seconds() - worked:5.0f} s"
        rows.append("; ".join([f"{name:<12} {outcome:<7} {times}", *NOTES]))
    print("\n".join(["== environments", *rows]))
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
