"""Where rows are run: worker processes of this machine (loky, which joblib brings), or a Dask cluster.

Each gives a :class:`concurrent.futures.Executor`; what to do when workers die is in :mod:`coopqp.studies.dispatch`.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor
from contextlib import AbstractContextManager
from importlib.util import find_spec
from typing import Any, ClassVar, final

from coopqp.checks import as_count
from coopqp.errors import InvalidInputError, MissingExtraError, said
from coopqp.studies.errors import EngineError

#: Variables that give each worker one thread for linear algebra.
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")}
#: A worker looks this often whether its coordinator is still there [s].
_LOOK = 1.0


class Engine(ABC):
    """Runs chunks of rows.

    Attributes:
        workers: number of worker processes.
        chunk_s: a chunk of rows should take this much processor time [s]; shorter ones cost more than they do.
        tries: a row that is run alone is lost after its worker died this many times.
    """

    workers: int
    chunk_s: ClassVar[float]
    tries: ClassVar[int]

    @abstractmethod
    def open(self, workers: int) -> AbstractContextManager[Executor]:
        """An executor with at most this many workers. Leaving it by an exception ends its workers at once."""

    @abstractmethod
    def has_died(self, error: BaseException) -> bool:
        """Whether an error of a future says that workers died."""

    @abstractmethod
    def is_broken(self, error: BaseException) -> bool:
        """Whether the executor takes no more work after this error."""


@final
class Local(Engine):
    """Worker processes of this machine. They end with their coordinator, also when it is killed.

    Args:
        workers: number of worker processes; by default one per core.

    Raises:
        MissingExtraError: joblib is not installed.
    """

    chunk_s = 0.25
    tries = 3

    def __init__(self, workers: int | None = None) -> None:
        if find_spec("joblib") is None:
            raise MissingExtraError("studies", "joblib")
        from joblib import cpu_count

        self.workers = int(cpu_count()) if workers is None else as_count(workers, "Local: workers")

    @contextlib.contextmanager
    def open(self, workers: int) -> Iterator[Executor]:
        """A pool of loky."""
        from joblib.externals.loky.process_executor import ProcessPoolExecutor

        pool = ProcessPoolExecutor(
            max_workers=min(workers, self.workers), env=_ONE_THREAD, initializer=_begin, initargs=(os.getpid(),)
        )
        try:
            with warnings.catch_warnings():
                # A worker that waits for long ends by itself, and loky starts another one: no news to a user.
                warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
                yield pool
        finally:
            pool.shutdown(wait=True, kill_workers=True)

    def has_died(self, error: BaseException) -> bool:
        """As the base class says."""
        return isinstance(error, BrokenExecutor)

    def is_broken(self, error: BaseException) -> bool:
        """As the base class says."""
        return True


def _begin(coordinator: int) -> None:
    """In each worker: Ctrl-C is for the coordinator, and the worker ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.name == "posix":
        threading.Thread(target=_end_with, args=(coordinator,), daemon=True).start()


def _end_with(coordinator: int) -> None:
    while os.getppid() == coordinator:
        time.sleep(_LOOK)
    os._exit(1)


@final
class Cluster(Engine):
    """A Dask cluster that is already running, started as in Dask's documentation.

    Rows and their results are pickled, both ways: whoever answers at the address can run programs here.

    Args:
        address: address of its scheduler, as ``tcp://host:8786``, or ``tls://host:8786`` with ``security``.
        timeout: longest time until it answers [s].
        security: a :class:`distributed.Security` with the certificates of a cluster that uses TLS; by default those of
            Dask's own settings.

    Raises:
        MissingExtraError: Dask distributed is not installed.
        EngineError: there is no scheduler, it has no workers, or their versions differ from those here.
    """

    chunk_s = 3.0
    tries = 1  # Dask has tried it several times before it says so

    def __init__(self, address: str, *, timeout: float = 10.0, security: Any = None) -> None:
        if find_spec("distributed") is None:
            raise MissingExtraError("cluster", "distributed")
        if not isinstance(address, str) or not address:
            raise InvalidInputError(f"{address!r}", "Cluster: address", "Give an address, as tcp://host:8786.")
        self.address, self._timeout, self._security = address, timeout, security
        with self._client() as client:
            self.workers = len(client.nthreads())
            if not self.workers:
                raise EngineError(f"the cluster at {address} has no workers. Start them: dask worker {address}.")
            self._check_versions(client)

    def _client(self) -> Any:
        from distributed import Client

        try:
            more = {} if self._security is None else {"security": self._security}
            return Client(self.address, timeout=self._timeout, set_as_default=False, **more)
        except (OSError, ValueError) as error:
            raise EngineError(
                f"no Dask scheduler answers at {self.address} ({said(error)}). Start one: dask scheduler."
            ) from error

    def _check_versions(self, client: Any) -> None:
        from coopqp.studies.study import versions

        here = versions()
        try:
            there = client.run(versions)
        except Exception as error:  # any exception: workers without coopqp cannot even read the question
            raise EngineError(
                f"the workers at {self.address} cannot run coopqp ({said(error)}). Install it there."
            ) from error
        for worker, found in there.items():
            other = [f"{name} {found.get(name)} (here {here[name]})" for name in here if found.get(name) != here[name]]
            if other:
                raise EngineError(
                    f"worker {worker} has {', '.join(other)}: rows would differ. Install the same versions."
                )

    @contextlib.contextmanager
    def open(self, workers: int) -> Iterator[Executor]:
        """The executor of a client. The cluster stays when it ends."""
        with self._client() as client:
            executor: Executor = client.get_executor(pure=False)
            try:
                yield executor
            finally:
                executor.shutdown(wait=False)

    def has_died(self, error: BaseException) -> bool:
        """As the base class says."""
        from distributed.scheduler import KilledWorker

        return isinstance(error, KilledWorker)

    def is_broken(self, error: BaseException) -> bool:
        """As the base class says."""
        return False
