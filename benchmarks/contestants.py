"""Contestants: coopqp and its peers, each in a separate process, the peers in separate environments."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import export_cell
import numpy as np
import peer_cases

from coopqp import CollisionScene

HERE = Path(__file__).resolve().parent
#: Default folder of the peers' environments.
CACHE = HERE.parent / ".venv-peers"
#: Packages of each peer, installed in a separate environment.
PINS: dict[str, tuple[str, ...]] = {
    "pink": (
        "pin-pink==4.4.0",
        "pin==4.1.0",
        "qpsolvers==4.13.0",
        "daqp==0.11.0",
        "quadprog==0.1.14",
        "proxsuite==0.8.0",
        "osqp==1.1.3",
    ),
    "mink": ("mink==1.3.0", "mujoco==4.0.0", "qpsolvers==4.13.0", "daqp==0.11.0"),
    "placo": ("placo==0.10.2",),
    "oink": ("roboplan-oink==0.7.0",),
    "drake": ("drake==1.51.1",),
}
PIP_INSTALL = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:")
#: Periods of the steps [s]: without a pause, or one step per millisecond with caches used by other processes.
PACES = {"hot": 0.0, "1 kHz": 1e-3}
#: Largest accepted difference between the kinematics of a peer and coopqp [m, or entries of a rotation].
KINEMATICS_TOLERANCE = 1e-9


# -- environments ------------------------------------------------------------------------------------------------------


class NotAvailable(Exception):  # noqa: N818  # an outcome to report, not a fault
    """A peer cannot run; the message gives the reason."""


def environment(peer: str, cache: Path, *, install: bool) -> Path:
    """Path of Python in the peer's environment, which is created if needed and allowed.

    Raises:
        NotAvailable: the environment is missing and must not or cannot be created.
    """
    folder, pins = cache / peer, "\n".join(PINS[peer])
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    stamp = folder / "pins.txt"
    if stamp.is_file() and stamp.read_text() == pins and python.exists():
        return python
    if not install:
        raise NotAvailable("not installed")
    shutil.rmtree(folder, ignore_errors=True)
    for command in (
        [sys.executable, "-m", "venv", str(folder)],
        [str(python), *PIP_INSTALL, *PINS[peer]],
    ):
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise NotAvailable(f"cannot be installed: {type(error).__name__}") from error
        if done.returncode:
            errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
            raise NotAvailable(f"cannot be installed: {(errors or ['pip failed'])[-1][:160]}")
    stamp.write_text(pins)
    return python


class Contestant:
    """A contestant in its process.

    Args:
        name: name of the peer.
        python: its Python.
        script: its runner; that of benchmarks/peers by default.
        environment: variables that its process has besides.

    Attributes:
        name: name of the peer.
        version: version of its package.
        modes: available modes of a task.
        note: reason for leaving the benchmark, or empty.
    """

    def __init__(
        self, name: str, python: Path, *, script: Path | None = None, environment: Mapping[str, str] | None = None
    ) -> None:
        self.name, self.note = name, ""
        self._log = tempfile.TemporaryFile("w+", prefix=f"{name}_")  # noqa: SIM115  # closed by stop()
        self._process = subprocess.Popen(
            [str(python), str(script or HERE / "peers" / f"run_{name}.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env={**os.environ, **common.ONE_THREAD, **(environment or {})},
        )
        self._pending = b""
        hello = self._answer(120.0)
        self.version, self.modes = str(hello["version"]), tuple(hello["modes"])

    @staticmethod
    def start(name: str, cache: Path, *, install: bool) -> Contestant:
        """Start coopqp, or a peer in its environment, which is created if needed and allowed.

        Raises:
            NotAvailable: the peer cannot run.
        """
        return Contestant(name, Path(sys.executable) if name == "coopqp" else environment(name, cache, install=install))

    def load(self, file: Path) -> None:
        """Load a task in place of the last one.

        Raises:
            NotAvailable: the peer cannot load it, or its kinematics differ from coopqp's.
        """
        error = self.ask(do="load", file=str(file), timeout=600.0)["kinematics_error"]
        if not error <= KINEMATICS_TOLERANCE:
            raise NotAvailable(f"its kinematics differ by {error:.1e}")

    def ask(self, *, timeout: float, **command: Any) -> dict[str, Any]:
        """Send a command and return the answer.

        Raises:
            NotAvailable: no answer in time (solvers can hang), an ended process, or an error as the answer.
        """
        if self.note:
            raise NotAvailable(self.note)
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # _answer reports the reason
            self._process.stdin.write(json.dumps(command).encode() + b"\n")
            self._process.stdin.flush()
        answer = self._answer(timeout)
        if "error" in answer:
            raise NotAvailable(str(answer["error"]))
        return answer

    def _answer(self, timeout: float) -> dict[str, Any]:
        assert self._process.stdout is not None
        end = time.monotonic() + timeout
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while b"\n" not in self._pending:
                if not selector.select(max(0.0, end - time.monotonic())):
                    self.stop(f"no answer within {timeout:.0f} s")
                    raise NotAvailable(self.note)
                chunk = os.read(self._process.stdout.fileno(), 1 << 20)
                if not chunk:
                    self._log.seek(0)
                    lines = self._log.read().split("\n")
                    self.stop(f"ended: {' '.join(lines[-3:]).strip()[-160:]}")
                    raise NotAvailable(self.note)
                self._pending += chunk
        line, _, self._pending = self._pending.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def stop(self, note: str = "stopped") -> None:
        """End the process."""
        self.note = self.note or note
        self._process.kill()
        self._process.wait()
        self._log.close()


# -- files of the task -------------------------------------------------------------------------------------------------


def hand_over(case: peer_cases.Case, folder: Path, scene: CollisionScene | None = None) -> Path:
    """Write the cell and the task for the peers, with the bodies that keep distances. Returns the task's file."""
    folder.mkdir(parents=True)
    s = case.scenario
    (folder / "cell.urdf").write_text(export_cell.urdf(s.cell))
    (folder / "cell.xml").write_text(export_cell.mjcf(s.cell, scene))
    joints, tools = export_cell.names(s.cell)
    low, high = (np.clip(x, -np.pi, np.pi) for x in (s.cell.limits.lower, s.cell.limits.upper))
    samples = [s.q_start, *np.random.default_rng(0).uniform(low, high, (2, s.cell.nv))]
    steps = max(1, round(s.path.duration / s.dt))
    task = {
        "case": case.name,
        "joints_each": len(joints) // len(tools),
        "urdf": "cell.urdf",
        "mjcf": "cell.xml",
        "joints": joints,
        "tools": tools,
        "q_start": s.q_start.tolist(),
        "speed": s.cell.limits.velocity.tolist(),
        "dt": s.dt,
        "noise": case.noise,
        "grasp": [X.homogeneous.tolist() for X in s.grasp.T_object_tool],
        "poses": [s.path.pose((i + 1) * s.dt).homogeneous.tolist() for i in range(steps)],
        "kinematics": [
            {"q": q.tolist(), "tools": [T.homogeneous.tolist() for T in export_cell.tools_at(s.cell, q)]}
            for q in samples
        ],
    }
    if scene is not None:
        pairs = [[int(pair.first), int(pair.second)] for pair in scene.built.geometry.collisionPairs]
        task["scene"] = {"shapes": export_cell.shapes(scene), "pairs": pairs, "margin": scene.margin}
    file = folder / "task.json"
    file.write_text(json.dumps(task))
    return file


def ratio(own: Sequence[Sequence[float]], other: Sequence[Sequence[float]], *, share: float = 50.0) -> float | None:
    """Time of ``own`` over that of ``other``: the median over the rounds of the ratio of this percentile."""
    pairs = [(a, b) for a, b in zip(own, other, strict=False) if len(a) and len(b)]
    return float(np.median([np.percentile(a, share) / np.percentile(b, share) for a, b in pairs])) if pairs else None


def pinned(peer: str) -> str:
    """The pinned version of a peer; empty for coopqp."""
    return PINS[peer][0].partition("==")[2] if peer in PINS else ""
