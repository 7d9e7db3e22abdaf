"""Engines: how many workers, what Dask is asked, and which errors say that workers died."""

from __future__ import annotations

import os
import signal
from concurrent.futures import BrokenExecutor, Future
from typing import Any, ClassVar

import pytest

from coopqp import InvalidInputError
from coopqp.errors import MissingExtraError
from coopqp.studies import Cluster, EngineError, Local, engines, run_rows
from coopqp.studies.study import versions

ADDRESS = "tcp://127.0.0.1:8786"


class Pool:
    """The executor of a client, which runs everything at once."""

    def __init__(self, said: list[Any]) -> None:
        self.said = said

    def submit(self, function: Any, /, *arguments: Any) -> Any:
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future

    def shutdown(self, *, wait: bool) -> None:
        self.said.append(("shutdown", wait))


class Client:
    """A client of a scheduler with two workers."""

    threads: ClassVar[dict[str, int]] = {"one": 4, "two": 1}
    answers: Any = None
    said: ClassVar[list[Any]] = []

    def __init__(self, address: str, **options: Any) -> None:
        self.said.append((address, options))

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.said.append("closed")

    def nthreads(self) -> dict[str, int]:
        return self.threads

    def run(self, function: Any) -> dict[str, Any]:
        if isinstance(self.answers, Exception):
            raise self.answers
        return self.answers or {worker: function() for worker in self.threads}

    def get_executor(self, **options: Any) -> Pool:
        self.said.append(("executor", options))
        return Pool(self.said)


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> type[Client]:
    distributed = pytest.importorskip("distributed")

    class Fresh(Client):
        said: ClassVar[list[Any]] = []

    monkeypatch.setattr(distributed, "Client", Fresh)
    return Fresh


def test_a_cluster_has_as_many_workers_as_its_scheduler_and_stays_when_rows_are_there(client: type[Client]) -> None:
    engine = Cluster(ADDRESS)
    assert engine.workers == 2
    assert engine.address == ADDRESS
    options = {"timeout": 10.0, "set_as_default": False}
    assert client.said == [(ADDRESS, options), "closed"]
    client.said.clear()
    taken: list[Any] = []
    run_rows(lambda row: {"x": row}, range(5), engine, take=taken.extend)
    assert sorted(done.row for done in taken) == [0, 1, 2, 3, 4]
    assert client.said == [(ADDRESS, options), ("executor", {"pure": False}), ("shutdown", False), "closed"]
    client.said.clear()
    Cluster(ADDRESS, timeout=2.5)
    assert client.said[0] == (ADDRESS, {**options, "timeout": 2.5})


def test_a_cluster_without_workers_or_with_others_is_refused_by_name(client: type[Client]) -> None:
    client.threads = {}
    with pytest.raises(EngineError, match=rf"cluster at {ADDRESS} has no workers.*dask worker {ADDRESS}"):
        Cluster(ADDRESS)
    client.threads = {"one": 1}
    client.answers = ModuleNotFoundError("no coopqp here")
    with pytest.raises(EngineError, match=rf"workers at {ADDRESS} cannot run coopqp \(.*no coopqp here.*Install it"):
        Cluster(ADDRESS)
    here = versions()
    client.answers = {"one": here, "two": {**here, "numpy": "1.0", "daqp": None}}
    with pytest.raises(EngineError, match="rows would differ") as caught:
        Cluster(ADDRESS)
    told = f"worker two has numpy 1.0 (here {here['numpy']}), daqp None (here {here['daqp']}): rows would differ"
    assert told in str(caught.value)
    client.answers = {"one": here, "two": {**here, "more": "1.0"}}
    assert Cluster(ADDRESS).workers == 1


@pytest.mark.parametrize("address", ["", None, 8786])
def test_an_address_is_a_text(address: Any) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(InvalidInputError, match=r"Cluster: address.*tcp://host:8786"):
        Cluster(address)


def test_only_a_killed_worker_is_dead_to_dask_and_its_scheduler_goes_on(client: type[Client]) -> None:
    from distributed.scheduler import KilledWorker

    engine = Cluster(ADDRESS)
    assert engine.tries == 1
    died = KilledWorker("chunk", None, 1)
    assert engine.has_died(died)
    assert not engine.has_died(BrokenExecutor())
    assert not engine.is_broken(died)


def test_a_pool_of_this_machine_that_lost_a_worker_is_broken() -> None:
    engine = Local(2)
    assert engine.has_died(BrokenExecutor())
    assert not engine.has_died(RuntimeError())
    assert engine.is_broken(BrokenExecutor())
    assert engine.tries == 3
    assert (Local.chunk_s, Cluster.chunk_s) == (0.25, 3.0)  # a chunk costs a cluster more


def test_there_is_a_worker_for_each_core_unless_a_number_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    import joblib

    monkeypatch.setattr(joblib, "cpu_count", lambda: 7)
    assert Local().workers == 7
    assert Local(3).workers == 3
    for number in (0, -1, 1.5, "two"):
        with pytest.raises(InvalidInputError, match="Local: workers"):
            Local(number)  # type: ignore[arg-type]


def test_workers_have_one_thread_each_and_no_more_of_them_start_than_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    from joblib.externals.loky import process_executor

    said: list[Any] = []

    class Processes:
        def __init__(self, **options: Any) -> None:
            said.append(options)

        def shutdown(self, **options: Any) -> None:
            said.append(options)

    monkeypatch.setattr(process_executor, "ProcessPoolExecutor", Processes)
    for asked, started in ((1, 1), (2, 2), (5, 2)):
        said.clear()
        with pytest.raises(KeyboardInterrupt), Local(2).open(asked):
            raise KeyboardInterrupt
        made, ended = said
        assert made["max_workers"] == started
        assert made["env"] == {
            f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")
        }
        assert ended == {"wait": True, "kill_workers": True}


def test_a_worker_leaves_ctrl_c_to_its_coordinator_and_ends_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The coordinator is alive at two looks, and gone at the third."""
    parents, said = iter([11, 11, 1]), list[Any]()

    class Thread:
        def __init__(self, *, target: Any, args: Any, daemon: bool) -> None:
            self.work, said[:] = (target, args), [*said, ("daemon", daemon)]

        def start(self) -> None:
            self.work[0](*self.work[1])

    monkeypatch.setattr("coopqp.studies.engines.threading.Thread", Thread)
    monkeypatch.setattr("coopqp.studies.engines.signal.signal", lambda *pair: said.append(pair))
    monkeypatch.setattr("coopqp.studies.engines.os.getppid", lambda: next(parents))
    monkeypatch.setattr("coopqp.studies.engines.os._exit", lambda status: said.append(("exit", status)))
    monkeypatch.setattr("coopqp.studies.engines.time.sleep", lambda seconds: said.append(("sleep", seconds)))
    from joblib.externals.loky import process_executor

    class Processes:
        def __init__(self, *, initializer: Any, initargs: Any, **_: Any) -> None:
            assert initargs == (os.getpid(),)
            initializer(11)

        def shutdown(self, **_: Any) -> None:
            pass

    monkeypatch.setattr(process_executor, "ProcessPoolExecutor", Processes)
    with Local(1).open(1):
        pass
    assert said == [
        (signal.SIGINT, signal.SIG_IGN), ("daemon", True), ("sleep", 1.0), ("sleep", 1.0), ("exit", 1),
    ]  # fmt: skip


@pytest.mark.parametrize(("engine", "missing"), [(Local, "joblib"), (Cluster, "distributed")])
def test_an_extra_that_is_missing_is_named(engine: Any, missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "find_spec", lambda name: None if name == missing else object())
    with pytest.raises(MissingExtraError, match=missing):
        engine(*([ADDRESS] if engine is Cluster else []))
