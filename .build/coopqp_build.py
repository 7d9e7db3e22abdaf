"""The build backend: scikit-build-core, and on Linux without a C++ compiler one from the package index.

Zig's compiler (``ziglang``) is Clang with libc++, and needs nothing else. The first program that it links has it
compile libc++, a minute of work: it keeps that in the user's cache, but a Zig that is installed anew makes another, and
installers do so for each build. A compiler that works is never replaced, and a CXX that is set is left to
CMake, as is every other system.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

from scikit_build_core import build as backend
from scikit_build_core.build import *  # noqa: F403  # the hooks that are not below

Settings = dict[str, "list[str] | str"] | None

#: Where the index has none, installers show nothing but this line: its second part, which always holds, says the rest.
ZIG = "ziglang~=0.17.1,!=0+no.cpp.compiler.works.install.gcc.or.clang"
#: What CMake looks for, and a program that needs the standard library and the linker.
COMPILERS = ("c++", "g++", "clang++")
PROGRAM = "#include <vector>\nint main() { return std::vector<int>(1).at(0); }\n"


def works(compiler: str) -> bool:
    """Whether a compiler is on the path and makes a program."""
    if not shutil.which(compiler):
        return False
    with tempfile.TemporaryDirectory() as folder:
        command = [compiler, "-x", "c++", "-", "-o", str(Path(folder, "program"))]
        return subprocess.run(command, input=PROGRAM, text=True, capture_output=True, check=False).returncode == 0


def missing() -> bool:
    """Whether the compiler has to come from the index."""
    return sys.platform == "linux" and not os.environ.get("CXX") and not any(map(works, COMPILERS))


@contextmanager
def compiler() -> Iterator[None]:
    """Zig's compiler as CXX, with the archiver beside it, where the compiler is missing.

    It compiles for the processor that it runs on if no other is named. It makes a libc++ for each kind of program:
    with these options all are of one kind, also those by which CMake tries the compiler.
    """
    if not missing():
        yield
        return
    found = find_spec("ziglang")
    if found is None or found.origin is None:
        sys.exit(
            "coopqp was not built: no C++ compiler works here. Install one (Debian: apt install g++; Fedora: dnf "
            "install gcc-c++), or ziglang: pip install ziglang"
        )
    with tempfile.TemporaryDirectory() as folder:
        for name, options in {"c++": "-mcpu=baseline -O2 -s", "ar": "", "ranlib": ""}.items():
            script = Path(folder, name)
            zig = shlex.quote(str(Path(found.origin).with_name("zig")))
            script.write_text(f'#!/bin/sh\nexec {zig} {name} {options} "$@"\n', encoding="utf-8")
            script.chmod(0o755)
        os.environ["CXX"] = str(Path(folder, "c++"))
        try:
            yield
        finally:
            del os.environ["CXX"]


def say(text: str) -> None:
    """Tell whoever waits. Installers show nothing that a build prints, so this is written to the terminal itself."""
    with suppress(OSError), Path("/dev/tty").open("w", encoding="utf-8") as terminal:
        terminal.write(f"\r{text}\n")


@contextmanager
def compiling() -> Iterator[None]:
    """The compiler, and how long it takes."""
    long = "some minutes, as Zig's compiler makes its libc++ first" if missing() else "one to two minutes on two cores"
    say(f"coopqp: compiling its core: {long}")
    began = time.monotonic()
    with compiler():
        yield
    say(f"coopqp: compiled in {time.monotonic() - began:.0f} s")


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """What scikit-build-core requires, and a compiler where none works."""
    return backend.get_requires_for_build_wheel(config_settings) + [ZIG] * missing()


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """What scikit-build-core requires, and a compiler where none works."""
    return backend.get_requires_for_build_editable(config_settings) + [ZIG] * missing()


def build_wheel(directory: str, config_settings: Settings = None, metadata_directory: str | None = None) -> str:
    """As scikit-build-core builds, with that compiler."""
    with compiling():
        return backend.build_wheel(directory, config_settings, metadata_directory)


def build_editable(directory: str, config_settings: Settings = None, metadata_directory: str | None = None) -> str:
    """As scikit-build-core builds, with that compiler."""
    with compiling():
        return backend.build_editable(directory, config_settings, metadata_directory)
