"""What every runner does: read a task, then answer commands, one JSON line each. Standard library and NumPy only.

Timed is what a control loop does once a period, the same for coopqp and for its peers: take the reading where the case
has one, compute the command, and have the vector of joint positions in hand that goes to the servos. The reading is
made before, and the command is kept after, outside the timed part.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import sys
import time
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Untimed steps at the start of each round: the caches belonged to another contestant.
WARM_UP = 20
#: Different rows of noise; step ``i`` has row ``i`` modulo this.
NOISE_ROWS = 997
#: CPU time of the process, all threads [ns]: other processes on the machine do not count, except through caches.
clock = time.process_time_ns


class Task:
    """The cell, its start, and its task.

    Attributes:
        urdf, mjcf: files.
        joints, tools: names in them, in the order of configurations and of the arms.
        q_start: (nv,).
        grasp: T_object_tool of each arm (N, 4, 4).
        poses: the object's target at the end of each step (T, 4, 4).
        targets: the tools' targets (T, N, 4, 4).
        speed: velocity limits (nv,) [rad/s or m/s].
        dt: length of a step [s].
        noise: of readings (NOISE_ROWS, nv) [rad or m]; None where the case has no readings.
        spec: the task as it was handed over.
    """

    def __init__(self, file: str) -> None:
        spec: dict[str, Any] = json.loads(Path(file).read_text())
        folder = Path(file).parent
        self.spec = spec
        self.urdf, self.mjcf = str(folder / spec["urdf"]), str(folder / spec["mjcf"])
        self.joints: list[str] = spec["joints"]
        self.tools: list[str] = spec["tools"]
        self.q_start, self.speed = np.array(spec["q_start"]), np.array(spec["speed"])
        self.grasp, self.poses = np.array(spec["grasp"]), np.array(spec["poses"])
        self.targets = self.poses[:, None] @ self.grasp[None]
        self.dt = float(spec["dt"])
        self.arms = len(self.tools)
        self.noise: Array | None = None
        if spec["noise"] is not None:
            amplitude = float(spec["noise"])
            self.noise = np.random.default_rng(0).uniform(-amplitude, amplitude, (NOISE_ROWS, len(self.joints)))

    def relative(self, k: int) -> Array:
        """Placement of tool ``k`` in the frame of tool 0 when the object is held."""
        placement: Array = np.linalg.inv(self.grasp[0]) @ self.grasp[k]
        return placement


class Motion(Protocol):
    """One way (mode) of doing a task with a peer; holds its configuration."""

    def over(self, i: int) -> bool:
        """Whether the path ends before step ``i``."""
        ...

    def start(self) -> None:
        """Go back to the start of the task."""
        ...

    def step(self, i: int, reading: Array | None) -> Array:
        """One period: targets of step ``i``, kinematics, solve, integrate; the benchmark times this.

        Args:
            i: number of the step.
            reading: measured configuration (nv,), from which the step goes on; None to go on from the last command.

        Returns:
            The command (nv,); the next step may overwrite the array.

        Raises:
            Exception: no command; the arms hold still.
        """
        ...

    def failure(self) -> str:
        """Empty, or why the last step's command only brakes."""
        ...

    def rate(self) -> float:
        """Share of the motion that the last step kept."""
        ...


class Timed:
    """Motions whose targets come one a step, wherever the arms are."""

    _task: Task

    def over(self, i: int) -> bool:
        return i >= len(self._task.poses)

    def failure(self) -> str:
        return ""

    def rate(self) -> float:
        return 1.0


class Runner(Protocol):
    """A peer."""

    package: str
    modes: tuple[str, ...]

    def load(self, task: Task) -> None:
        """Read the cell."""
        ...

    def tools_at(self, q: Array) -> Array:
        """Placement of every tool in the world at ``q`` (N, 4, 4)."""
        ...

    def motion(self, mode: str) -> Motion:
        """A new motion at the start of the task."""
        ...


def _own_cost() -> int:
    """What the clock measures of itself [ns], which is no part of a step."""
    spans = []
    for _ in range(2000):
        began = clock()
        spans.append(clock() - began)
    return sorted(spans)[1000]


class _Session:
    """A motion that is carried on from round to round, and the servos: they report the command before the last.

    Attributes:
        motion: the motion under test.
        i: number of the next step.
        command: the last one (nv,), or the start.
    """

    clock_ns = _own_cost()

    def __init__(self, motion: Motion, task: Task) -> None:
        self.motion, self._task, self._turn = motion, task, 0
        self._begin()

    def _begin(self) -> None:
        self.i, self.command, self._before = 0, self._task.q_start, self._task.q_start
        self._read()

    def start(self) -> None:
        """Go back to the start of the task."""
        self.motion.start()
        self._begin()

    def _read(self) -> None:
        """Make the reading of the next step: one sample late, with noise."""
        noise = self._task.noise
        self._reading = None if noise is None else self._before + noise[self._turn % len(noise)]
        self._turn += 1

    def advance(self, *, again: bool = True) -> tuple[int, str]:
        """One step; starts again at the path's end, if wanted. Returns its CPU time [ns] and the failure, if any.

        The next step's reading is made here, after this step: between the pause of a paced loop and its step nothing
        runs that would warm the caches.
        """
        i = self.i if again else min(self.i, len(self._task.poses) - 1)
        motion, reading, note, command = self.motion, self._reading, "", None
        began = clock()
        try:
            command = motion.step(i, reading)
        except Exception as error:
            note = _reason(error)
        took = clock() - began - self.clock_ns
        self.i += 1
        self._before = self.command
        if command is not None:
            self.command = np.array(command)
            note = motion.failure()[:160]
        if again and motion.over(self.i):
            self.start()
        else:
            self._read()
        return took, note


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}"[:160]


class _Server:
    def __init__(self, runner: Runner) -> None:
        self.runner, self.sessions = runner, dict[str, _Session]()
        self.task: Task | None = None

    def _session(self, mode: str) -> _Session:
        assert self.task is not None
        if mode not in self.sessions:
            self.sessions[mode] = _Session(self.runner.motion(mode), self.task)
        return self.sessions[mode]

    def load(self, file: str) -> dict[str, Any]:
        """Read the task; compare the kinematics."""
        self.task = None
        self.sessions.clear()
        task = Task(file)
        self.runner.load(task)
        self.task = task
        worst = 0.0
        for sample in task.spec["kinematics"]:
            worst = max(worst, float(np.abs(self.runner.tools_at(np.array(sample["q"])) - sample["tools"]).max()))
        return {"kinematics_error": worst}

    def forget(self) -> dict[str, Any]:
        """Free the memory of all motions; the task is kept."""
        self.sessions.clear()
        return {}

    def behave(self, mode: str, steps: int, budget: float) -> dict[str, Any]:
        """Up to ``steps`` steps from the start: commands, failures (a failed step holds still), times."""
        session = self._session(mode)
        session.start()
        rows, times, failures, note, least = [session.command.tolist()], [], 0, "", 1.0
        end = time.perf_counter() + budget
        for i in range(steps):
            took, failed = session.advance(again=False)
            times.append(took / 1e3)
            if failed:
                failures += 1
                note = note or failed
            else:
                least = min(least, session.motion.rate())
            if not np.isfinite(session.command).all():
                failures += steps - i
                note = note or "the configuration is not finite"
                break
            rows.append(session.command.tolist())
            if time.perf_counter() > end:
                break
        session.start()
        return {"q": rows, "us": times, "failures": failures, "note": note, "least": least}

    def time(self, mode: str, steps: int, period: float, budget: float) -> dict[str, Any]:
        """Times of up to ``steps`` steps [µs], hot (period 0) or one every ``period`` seconds."""
        session, times, failures, note = self._session(mode), [], 0, ""
        for _ in range(WARM_UP):
            session.advance()
        end = time.perf_counter() + budget
        due = time.perf_counter()
        for _ in range(steps):
            if period:
                now = time.perf_counter()
                due += period * max(1.0, np.ceil((now - due) / period))
                time.sleep(max(0.0, due - now))
            took, failed = session.advance()
            times.append(took / 1e3)
            failures += bool(failed)
            note = note or failed
            if time.perf_counter() > end:
                break
        return {"us": times, "failures": failures, "note": note}


def _version(package: str) -> str:
    """The installed version; "unknown" for a package that runs from its source tree."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def serve(runner: Runner) -> None:
    """Answer commands on stdin until it ends; what libraries print goes to stderr."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    server = _Server(runner)
    hello = {"version": _version(runner.package), "modes": list(runner.modes)}
    print(json.dumps(hello), file=answers, flush=True)
    for line in sys.stdin:
        command = json.loads(line)
        try:
            answer = getattr(server, command.pop("do"))(**command)
        except Exception as error:
            answer = {"error": _reason(error)}
        print(json.dumps(answer), file=answers, flush=True)
