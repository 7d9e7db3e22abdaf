"""Ctrl-C at any line of what writes files: what was there, or all that was asked for; no partial file, no folder."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from marks import slow_unless

import coopqp.output
from coopqp import Recording
from coopqp.cli.runs import write_products
from coopqp.files import write_bag, write_csv
from coopqp.output import Interrupts, whole_file, write_files
from coopqp.simulation.recording import recording, rows

#: Files whose lines are interrupted.
LINES = {coopqp.output.__file__, recording.__file__, rows.__file__, sys.modules[write_bag.__module__].__file__}


@pytest.fixture(autouse=True)
def ctrl_c() -> Iterator[None]:
    """As at a terminal: a shell that starts the tests in the background has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def at_line(number: int, call: Callable[[], Any]) -> bool:
    """Call with Ctrl-C at a line of the files that are looked at; False if there were fewer lines."""
    seen = 0

    def trace(frame: Any, event: str, _: Any) -> Any:
        nonlocal seen
        if frame.f_code.co_filename not in LINES:
            return None
        if event == "line":
            seen += 1
            if seen == number:
                signal.raise_signal(signal.SIGINT)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(before)
    return seen >= number


def write_stream(place: Path) -> None:
    with whole_file(place / "a" / "b" / "c") as stream:
        for part in (b"one ", b"two ", b"three"):
            stream.write(part)


WRITERS: dict[str, tuple[Callable[[Recording, Path], object], int]] = {
    "files": (lambda _, place: write_files({place / "a" / "x": b"1", place / "b" / "c" / "y": b"2"}), 1),
    "stream": (lambda _, place: write_stream(place), 1),
    "recording": (lambda run, place: write_products(run, place / "new", ["recording"]), 1),
    "csv": (lambda run, place: write_csv(run, place / "new" / "run.csv"), 5),
    "bag": (lambda run, place: write_bag(run, place / "new" / "bag"), 23),
}


@pytest.mark.parametrize("name", slow_unless(lambda name: name not in ("recording", "csv", "bag"), WRITERS))
def test_at_any_line(name: str, baseline: Callable[..., Recording], tmp_path: Path) -> None:
    write, step = WRITERS[name]
    run = baseline(4)
    complete = tmp_path / "complete"
    complete.mkdir()
    write(run, complete)
    names = sorted(str(p.relative_to(complete)) for p in complete.rglob("*"))
    assert names
    outcomes, number = set(), 1
    while True:
        place = tmp_path / str(number)
        place.mkdir()
        more = at_line(number, lambda place=place: write(run, place))  # type: ignore[misc]
        left = sorted(str(p.relative_to(place)) for p in place.rglob("*"))
        assert left in ([], names), (number, left)
        outcomes.add(bool(left))
        if not more:
            break
        number += step
    assert outcomes == {True, False}


def test_a_file_that_was_there_stays_or_is_replaced_whole(tmp_path: Path) -> None:
    file = tmp_path / "x"
    for number in range(1, 100):
        file.write_bytes(b"old")
        more = at_line(number, lambda: write_files({file: b"new"}))
        assert file.read_bytes() in (b"old", b"new")
        assert list(tmp_path.iterdir()) == [file]
        if not more:
            return
    pytest.fail("it does not end")


def interrupted(call: Callable[[Interrupts], None]) -> None:
    with Interrupts() as interrupts:
        call(interrupts)


def test_ctrl_c_waits_and_is_not_lost() -> None:
    done = []

    def waits(_: Interrupts) -> None:
        signal.raise_signal(signal.SIGINT)
        done.append("the block")

    def waits_for_a_while(interrupts: Interrupts) -> None:
        signal.raise_signal(signal.SIGINT)
        done.append("a while")
        interrupts.check()
        done.append("not reached")

    def does_not_wait(interrupts: Interrupts) -> None:
        with interrupts.let_through():
            signal.raise_signal(signal.SIGINT)
            done.append("not reached")

    for call in (waits, waits_for_a_while, does_not_wait):
        with pytest.raises(KeyboardInterrupt):
            interrupted(call)
    assert done == ["the block", "a while"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_does_not_end_the_cleaning() -> None:
    cleaned = []

    def work(interrupts: Interrupts) -> None:
        try:
            with interrupts.let_through():
                signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)
            cleaned.append(True)

    with pytest.raises(KeyboardInterrupt):
        interrupted(work)
    assert cleaned == [True]


def test_threads_and_ignored_interrupts_are_left_alone(tmp_path: Path) -> None:
    thread = threading.Thread(target=lambda: write_files({tmp_path / "a": b"1"}))
    thread.start()
    thread.join(timeout=30)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        write_files({tmp_path / "b": b"1"})
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]
