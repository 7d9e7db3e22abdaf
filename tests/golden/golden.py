"""Runs of one controller, and the steps that were recorded of the same runs.

A case feeds a run with what its own steps led to. So what is measured is always as far from what is commanded as the
case says, to the last bit, and a difference of rounding stays one. Were it fed from the record, every step would be led
back by what was rounded when that was written.
"""

from __future__ import annotations

import copy
import re
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tapes import SAME, Tape, difference, from_bytes, to_bytes

from coopqp import ControlStep, ObjectPath, QPController, QPOptions, Status
from coopqp.scenarios import Scenario
from coopqp.spatial import Array

#: Where the steps are kept, a file for each test with two entries for each of its cases.
KEPT = Path(__file__).parent / "kept"
#: What one sample of a run feeds to a step: the measured configuration (nq,) or None, and dt.
Inputs = Callable[[int, list[Array]], tuple[Any, Any]]


@dataclass
class Run:
    """A controller, and the steps that it made."""

    golden: Golden
    controller: Any
    same: float = SAME
    told: list[Array] = field(default_factory=list)
    steps: list[ControlStep] = field(default_factory=list)
    bounds: list[float] = field(default_factory=list)
    #: What had to be seen since this was emptied, and the slowest of all steps.
    seen: set[Status] = field(default_factory=set)
    lowest: float = 1.0

    def __post_init__(self) -> None:
        self.golden.runs.append(self)

    def take(self, q: Any = None, dt: Any = None, **more: Any) -> ControlStep:
        """One step."""
        return self.add(self.controller.step(q, dt=dt, **more))

    def add(self, step: ControlStep) -> ControlStep:
        """A step that was made elsewhere."""
        self.steps.append(step)
        self.told.append(step.q_next)
        self.bounds.append(self.same)
        self.seen.add(step.status)
        self.lowest = min(self.lowest, step.rate)
        return step

    def run(self, steps: int, inputs: Inputs | None = None) -> Run:
        """Steps until the path ends, or so many."""
        for i in range(steps):
            q, dt = (None, None) if inputs is None else inputs(i, self.told)
            if self.take(q, dt).finished:
                break
        return self

    def ask(self, call: Callable[[Any], Any]) -> None:
        """What an operator asks for."""
        call(self.controller)

    def copied(self) -> None:
        """From here on a copy of the controller makes the steps."""
        self.controller = copy.deepcopy(self.controller)

    def beside(self) -> Run:
        """Another run that goes on with a copy of the controller."""
        return Run(self.golden, copy.deepcopy(self.controller), self.same)


class Golden:
    """The runs of one case.

    Args:
        name: of the test that the case is of.
        case: its parameters.
        disturbed: the configurations to start at are moved by up to this [rad or m].
        seed: where to.
    """

    def __init__(self, name: str, case: str, *, disturbed: float = 0.0, seed: int = 0) -> None:
        self.name, self.case = name, case
        self.runs: list[Run] = []
        self._disturbed, self._rng = disturbed, np.random.default_rng(seed)

    def start(
        self, task: Scenario, *, path: Callable[[], ObjectPath] | None = None, dt: float = 0.0,
        constraints: Sequence[Any] = (), **options: Any,
    ) -> Run:  # fmt: skip
        """A run from the start of a scenario, along its path or another one."""
        given = QPOptions(**options)
        follow = task.path if path is None else path()
        made = QPController(
            task.cell, task.grasp, follow, dt=dt or task.dt, options=given, constraints=list(constraints)
        )
        away = self._disturbed * self._rng.uniform(-1.0, 1.0, task.cell.nv)
        made.reset(task.cell.moved(task.q_start, away) if self._disturbed else task.q_start)
        return Run(self, made)

    def of(self, controller: Any, same: float = SAME) -> Run:
        """A run of a controller that has been built and reset elsewhere."""
        return Run(self, controller, same)

    def tapes(self) -> list[Tape]:
        """What the runs did."""
        return [Tape.of(run.steps) for run in self.runs]

    @property
    def file(self) -> Path:
        """Where the case is kept."""
        return KEPT / f"{self.name}.zip"

    def kept(self) -> list[Tape]:
        """What was recorded of the case."""
        with zipfile.ZipFile(self.file) as file:
            return from_bytes(file.read(f"{self.case}.numbers"), file.read(f"{self.case}.words"))

    def differs(self, kept: Sequence[Tape]) -> str:
        """Where the runs differ first from others, in words; "" if they do not."""
        if len(kept) != len(self.runs):
            return f"{len(kept)} runs were made, and now {len(self.runs)}"
        for number, (run, made, before) in enumerate(zip(self.runs, self.tapes(), kept, strict=True)):
            if found := difference(made, before, np.array(run.bounds)):
                i, what = found
                now = run.steps[i].explain() if i < len(run.steps) else "no step"
                return f"run {number}, step {i} of {len(before)}: {what}; now: {now}"
        return ""

    def write(self) -> None:
        """Keep what the runs did in place of what was kept of this case; entries of others stay as they are."""
        numbers, words = to_bytes(self.tapes())
        write(self.file, {**entries(self.file), f"{self.case}.numbers": numbers, f"{self.case}.words": words})


def entries(file: Path) -> dict[str, bytes]:
    """What a file holds; nothing, if there is none."""
    if not file.exists():
        return {}
    with zipfile.ZipFile(file) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def write(file: Path, given: dict[str, bytes]) -> None:
    """A file that holds this and nothing else, the same bytes whenever it is written."""
    file.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(file, "w") as opened:
        for name in sorted(given):
            opened.writestr(zipfile.ZipInfo(name), given[name])


def named(nodeid: str) -> tuple[str, str]:
    """The name of a test without ``test_``, and its parameters."""
    name, _, case = nodeid.rpartition("::")[2].partition("[")
    return re.sub(r"^test_", "", name), case.removesuffix("]") or "-"


class Session:
    """How cases are begun and ended: in a test each is compared with what was kept of it.

    Args:
        how: see :class:`Golden`.
    """

    def __init__(self, **how: Any) -> None:
        self._how = how

    def begin(self, nodeid: str) -> Golden:
        """A case begins."""
        return Golden(*named(nodeid), **self._how)

    def end(self, made: Golden) -> None:
        """Its runs are made."""
        differs = made.differs(made.kept())
        assert not differs, differs


#: Of the tests; the recorder has others.
SESSION = Session()
