"""The build takes the compiler that is there, and one from the package index where none is."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("wheel", "editable")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere compilers are left to CMake")


@pytest.fixture
def build(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., ModuleType]:
    """The backend on a machine with some programs; scikit-build-core, which is seldom installed, has a stand-in."""

    def made(**programs: str) -> ModuleType:
        for name, text in programs.items():
            program = tmp_path / "bin" / {"cxx": "c++", "gxx": "g++"}[name]
            program.parent.mkdir(exist_ok=True)
            program.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
            program.chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path / "bin"))
        monkeypatch.delenv("CXX", raising=False)
        below = ModuleType("build")
        for kind in KINDS:
            setattr(below, f"get_requires_for_build_{kind}", lambda settings: ["ninja"])
            setattr(below, f"build_{kind}", lambda directory, *others: os.environ.get("CXX", "the compiler at hand"))
        monkeypatch.setitem(sys.modules, "scikit_build_core", ModuleType("scikit_build_core"))
        monkeypatch.setattr(sys.modules["scikit_build_core"], "build", below, raising=False)
        monkeypatch.setitem(sys.modules, "scikit_build_core.build", below)
        spec = importlib.util.spec_from_file_location("coopqp_build", ROOT / ".build" / "coopqp_build.py")
        assert spec is not None
        assert spec.loader is not None
        backend = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(backend)
        return backend

    return made


def required(backend: ModuleType) -> list[list[str]]:
    return [getattr(backend, f"get_requires_for_build_{kind}")() for kind in KINDS]


def built(backend: ModuleType) -> list[str]:
    return [getattr(backend, f"build_{kind}")("") for kind in KINDS]


def test_a_compiler_that_works_is_taken_and_nothing_is_asked_for(build: Callable[..., ModuleType]) -> None:
    backend = build(cxx="exit 1", gxx="exit 0")
    assert required(backend) == [["ninja"]] * 2
    assert built(backend) == ["the compiler at hand"] * 2


def test_a_build_says_that_it_compiles_and_how_long_that_takes(
    build: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    backend = build(cxx="exit 0")
    monkeypatch.setattr(backend, "say", said.append)
    assert built(backend) == ["the compiler at hand"] * 2
    assert said[::2] == ["coopqp: compiling its core: one to two minutes on two cores"] * 2
    assert all(re.fullmatch(r"coopqp: compiled in \d+ s", text) for text in said[1::2])


def test_a_compiler_that_is_set_is_never_replaced(
    build: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one that does not work: CMake says so of it."""
    backend = build()
    monkeypatch.setenv("CXX", "/bin/false")
    assert required(backend) == [["ninja"]] * 2
    assert built(backend) == ["/bin/false"] * 2


def test_where_no_compiler_works_the_index_has_one(
    build: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In a folder whose name needs quotes; the archiver that CMake looks for beside the compiler is Zig's, too."""
    backend = build(cxx="exit 1")
    assert required(backend) == [["ninja", backend.ZIG]] * 2
    assert backend.ZIG.startswith("ziglang")
    package = tmp_path / "it's here" / "ziglang"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "zig").write_text('#!/bin/sh\necho "$@"\n', encoding="utf-8")
    (package / "zig").chmod(0o755)
    monkeypatch.syspath_prepend(package.parent)
    said: list[list[str]] = []

    def builds(directory: str, *others: object) -> str:
        compiler = Path(os.environ["CXX"])
        for name in ("c++", "ar", "ranlib"):
            command = [str(compiler.with_name(name)), "a b.o"]
            said.append(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
        return compiler.name

    monkeypatch.setattr(backend.backend, "build_wheel", builds)
    assert backend.build_wheel("") == "c++"
    assert [words[0] for words in said] == ["c++", "ar", "ranlib"]
    assert all(words[-2:] == ["a", "b.o"] for words in said)
    assert "CXX" not in os.environ


def test_with_neither_one_error_says_what_to_install(
    build: Callable[..., ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    backend = build()
    monkeypatch.setattr(backend, "find_spec", lambda name: None)
    for kind in KINDS:
        with pytest.raises(
            SystemExit, match=r"no C\+\+ compiler works here\. Install one .*apt install g\+\+.*ziglang"
        ):
            getattr(backend, f"build_{kind}")("")
    assert "no.cpp.compiler.works.install.gcc" in backend.ZIG  # all that pip shows where the index has no ziglang
