"""The loop that runs rows until all are there: a broken pool is rebuilt, and rows that kill their workers are found.

A chunk whose worker died is suspect: it is run alone, and halved as often as its worker dies again. A single row that
was alone each time is lost; all others are there.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from typing import Any, final

from coopqp.errors import said
from coopqp.studies.engines import Engine
from coopqp.studies.errors import EngineError

#: Most rows of a chunk, and chunks in flight for each worker.
MOST_ROWS, IN_FLIGHT = 1000, 2


@dataclass(frozen=True)
class Done:
    """A row that is there.

    Attributes:
        row: its number.
        columns: the task's result; None if it killed its workers.
        seconds: processor time that it took [s].
    """

    row: int
    columns: dict[str, Any] | None
    seconds: float


def run_chunk(task: Callable[[int], dict[str, Any]], rows: Sequence[int]) -> list[Done]:
    """Run rows one after the other; in a worker."""
    done = []
    for row in rows:
        start = time.thread_time()  # on a busy machine, too, it says how much work a row is
        columns = task(row)
        done.append(Done(row, columns, time.thread_time() - start))
    return done


def run_rows(
    task: Callable[[int], dict[str, Any]],
    rows: Iterable[int],
    engine: Engine,
    *,
    take: Callable[[list[Done]], None],
    chunk: int | None = None,
) -> None:
    """Run a task for every row, each once.

    Args:
        task: called with the number of a row in a worker; gives its columns. It is pickled.
        rows: numbers of the rows.
        engine: where.
        take: called here with rows that are there, in any order; each row comes once.
        chunk: rows that are sent together; by default as many as take :attr:`Engine.chunk_s`.

    Raises:
        EngineError: the engine cannot go on. What was taken is complete.
    """
    loop = _Loop(task, rows, engine, take, chunk)
    while loop.open:
        with engine.open(1 if loop.suspects else engine.workers) as executor:
            loop.use(executor)


@final
class _Loop:
    """Rows that wait, fly, or are suspect."""

    def __init__(
        self,
        task: Callable[[int], dict[str, Any]],
        rows: Iterable[int],
        engine: Engine,
        take: Callable[[list[Done]], None],
        chunk: int | None,
    ) -> None:
        self.task, self.engine, self.take, self.chunk = task, engine, take, chunk
        self.waiting = deque(rows)
        self.suspects: deque[list[int]] = deque()
        self.deaths: Counter[int] = Counter()
        self.count, self.seconds = 0, 0.0

    @property
    def open(self) -> bool:
        """Whether rows are missing."""
        return bool(self.waiting or self.suspects)

    def use(self, executor: Executor) -> None:
        """Run rows until all are there, the executor is broken, or the suspects are cleared."""
        alone = bool(self.suspects)
        flying: dict[Future[list[Done]], list[int]] = {}
        while True:
            try:
                self._submit(executor, flying, alone=alone)
            except BrokenExecutor:
                self._harvest(flying)
                return
            if not flying:
                return
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                if self._land(future, flying.pop(future), alone=alone):
                    self._harvest(flying)
                    return

    def _submit(self, executor: Executor, flying: dict[Future[list[Done]], list[int]], *, alone: bool) -> None:
        if alone:
            if self.suspects and not flying:
                flying[executor.submit(run_chunk, self.task, self.suspects[0])] = self.suspects[0]
                self.suspects.popleft()
            return
        while self.waiting and len(flying) < IN_FLIGHT * self.engine.workers and not self.suspects:
            rows = [self.waiting[i] for i in range(min(self._size(), len(self.waiting)))]
            flying[executor.submit(run_chunk, self.task, rows)] = rows
            for _ in rows:
                self.waiting.popleft()

    def _size(self) -> int:
        """Rows of the next chunk: as many as take the time that the engine asks for, and a share for each worker."""
        if self.chunk is not None:
            return self.chunk
        if not self.count:
            return 1
        mean = max(self.seconds / self.count, 1e-9)
        share = math.ceil(len(self.waiting) / (IN_FLIGHT * self.engine.workers))
        return max(1, min(math.ceil(self.engine.chunk_s / mean), share, MOST_ROWS))

    def _land(self, future: Future[list[Done]], rows: list[int], *, alone: bool) -> bool:
        """Take what came back. Returns whether the executor is broken."""
        error = future.exception()
        if error is None:
            done = future.result()
            self.count, self.seconds = self.count + len(done), self.seconds + sum(one.seconds for one in done)
            self.take(done)
            return False
        if not self.engine.has_died(error):
            raise EngineError(
                f"the workers cannot go on: {said(error)}. Finished rows are kept: use --resume."
            ) from error
        if not alone:
            self.suspects.append(rows)
        elif len(rows) > 1:
            half = len(rows) // 2
            self.suspects.extendleft([rows[half:], rows[:half]])
        else:
            self.deaths[rows[0]] += 1
            if self.deaths[rows[0]] < self.engine.tries:
                self.suspects.appendleft(rows)
            else:
                self.take([Done(rows[0], None, 0.0)])
        return self.engine.is_broken(error)

    def _harvest(self, flying: dict[Future[list[Done]], list[int]]) -> None:
        """The rest of a broken executor: chunks that came back in time are taken, the others are suspect."""
        wait(flying)
        for future, rows in flying.items():
            self._land(future, rows, alone=False)
        flying.clear()
