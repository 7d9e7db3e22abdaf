"""Copies of the tree, in which one mutant after the other meets its tests."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mutants import c

ROOT = Path(__file__).resolve().parents[2]

#: Runs pytest as often as it is told to, each time in a child that finds all but this package imported.
_TESTER = """
import json, os, resource, sys
import hypothesis.strategies, numpy, pinocchio, pytest


class Told:
    def __init__(self, job):
        self.place = {name: i for i, name in enumerate(job["tests"])}

    def pytest_collection_modifyitems(self, items):
        items.sort(key=lambda item: self.place.get(item.nodeid.partition("[")[0], 1e9))


for line in sys.stdin:
    job = json.loads(line)
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_CPU, (job["limit"], job["limit"] + 5))
        said = os.open(job["said"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(said, 1), os.dup2(said, 2)
        status = 3
        try:
            status = int(pytest.main(job["arguments"], plugins=[Told(job)]))
        finally:
            sys.stdout.flush()
            os._exit(status)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def _left_out(_: str, names: list[str]) -> set[str]:
    """What tests do not read."""
    hidden = {name for name in names if name.startswith(".")} - {".ci", ".github", ".gitignore"}
    return hidden | {"out", "build", "dist", "__pycache__"}


class Copy:
    """A copy of the tree, with the compiled module for the processor's plain arithmetic."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT, folder, ignore=_left_out, symlinks=True)
        self.compiled = c.compile_copy(folder)
        path = [str(folder / "tests" / "elsewhere"), str(folder)]
        self.environment = {
            **os.environ, "PYTHONPATH": os.pathsep.join(path), "HYPOTHESIS_PROFILE": "mutation",
            "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
        }  # fmt: skip
        where = subprocess.run(
            [sys.executable, "-c", "import coopqp; print(coopqp.__file__)"],
            env=self.environment, cwd=folder, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert Path(where.stdout.strip()).is_relative_to(folder), where.stdout
        self._tester = subprocess.Popen(
            [sys.executable, "-c", _TESTER],
            env=self.environment, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def run(self, tests: Sequence[str], *options: str, limit: int) -> int:
        """The exit status of pytest with these files or tests, in this order; negative for a signal.

        ``limit`` is in seconds of a processor.
        """
        job = {
            "arguments": ["-p", "no:cacheprovider", "--timeout", "0", *options, *tests], "limit": limit,
            "tests": list(tests), "said": str(self.folder / "said.txt"),
        }  # fmt: skip
        assert self._tester.stdin is not None
        assert self._tester.stdout is not None
        print(json.dumps(job), file=self._tester.stdin, flush=True)
        return int(self._tester.stdout.readline())

    def killer(self, tests: Sequence[str], *options: str, limit: int) -> str:
        """The test that failed, or "" if none did."""
        if not tests:
            return ""
        status = self.run(tests, "-x", *options, limit=limit)
        if status in (0, 5):  # 5: no test of that kind
            return ""
        if status == -signal.SIGXCPU:
            return "runs for ever"
        said = (self.folder / "said.txt").read_text(encoding="utf-8", errors="replace")
        found = re.search(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
        return found.group(1) if found else f"status {status}"

    @contextmanager
    def changed(self, name: str, text: str) -> Iterator[bool]:
        """A file of C++ has another text for a while; yields False if it does not compile."""
        file = self.folder / name
        source = file.read_text(encoding="utf-8")
        built = next((self.folder / "coopqp" / "core").glob("_core*.so"))
        kept = built.read_bytes()
        try:
            file.write_text(text, encoding="utf-8")
            yield c.compile_copy(self.folder)
        finally:
            file.write_text(source, encoding="utf-8")
            built.unlink(missing_ok=True)  # a new file: a program that runs keeps the old one
            built.write_bytes(kept)
