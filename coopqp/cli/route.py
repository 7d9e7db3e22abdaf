"""The subcommand ``coopqp route``: a way round for the task of a cell file, searched and proved."""

from __future__ import annotations

import argparse
import contextlib
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.cli.terminal import add_command, print_written, reporter, say
from coopqp.errors import printable

if TYPE_CHECKING:
    from coopqp.files.cellfile.searched import SearchTask
    from coopqp.planning import Route

#: Exit statuses.
_FOUND, _IMPOSSIBLE, _NOT_FOUND, _INTERRUPTED = 0, 3, 4, 130
#: Time between reports of the progress [s].
_REPORT = 0.1
#: Time of the search that a check makes to offer it [s].
GLANCE = 1.0


def _add_route(commands: Any) -> None:
    parser = add_command(
        commands,
        "route",
        _run_route,
        force="what is there",
        help="find a way round the bodies of a cell file, and prove it",
        description="Search a path of the object from the start of a cell file's path to its end, round the bodies of "
        "its table [collision], for all arms at once; shorten it, round its corners off, and prove that the arms can "
        "follow it with all margins kept. Nothing moves.",
        epilog="Exit status: 0 with a way that is proved; 3 if start or goal is impossible; 4 if none was found, which "
        "proves nothing; 2 for bad input; 130 after Ctrl-C, what was found by then being written.",
    )
    parser.add_argument("cell", type=Path, metavar="CELL", help="the cell file, TOML or YAML, with a table [collision]")
    parser.add_argument("--time", type=_seconds, metavar="S", help="the longest search [s] (10, or the file's)")
    parser.add_argument("--seed", type=_seed, metavar="N", help="seed of the search (0, or the file's)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the way as a cell file, TOML")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the answer as JSON")
    parser.add_argument("--html", type=Path, metavar="FILE", help="also write a page that plays the way (extra viewer)")


def _run_route(arguments: argparse.Namespace) -> int:
    from coopqp.files.cellfile import require_readers
    from coopqp.output import check_new, json_bytes, write_files

    require_readers()
    from coopqp.files.cellfile.build import load_search
    from coopqp.files.cellfile.paths import folder_of
    from coopqp.files.cellfile.write import timed_text

    check_new(arguments.out, arguments.json, arguments.html, force=arguments.force)
    if arguments.html is not None:
        from coopqp.visualization.viewer import require_viser

        require_viser()
    given = {"time_limit": arguments.time, "seed": arguments.seed}
    changes = {name: value for name, value in given.items() if value is not None}
    settings, task = load_search(arguments.cell)
    with _interruptible() as interrupted:
        route = _searched(task, changes, interrupted, quiet=arguments.quiet)
    contents: dict[Path, bytes] = {}
    if arguments.out is not None and route.found:
        assert route.check is not None
        assert route.check.q_start is not None
        text = timed_text(
            settings, task.cell, route.check.q_start, task.path(route), f"A way of {route.length:.2f} m round, "
            "found and proved by coopqp. The path is in the table [path].",
            folder=folder_of(arguments.cell), into=arguments.out.parent,
        )  # fmt: skip
        contents[arguments.out] = text.encode()
    if arguments.json is not None:
        contents[arguments.json] = json_bytes(route.record())
    files = list(write_files(contents))
    if arguments.html is not None and route.found:
        from coopqp.visualization.route_page import export_route

        files.append(export_route(route, arguments.html))
    if not arguments.quiet:
        print(route.verdict.value)
        for line in route.explain().splitlines():
            print(printable(line))
        if route.found:
            print(f"first way after {route.first_s:.2f} s, proved after {route.total_s:.2f} s, {route.nodes} poses")
        print_written(files, apart=True)
    elif not route.found:
        say(route.reason)
    if interrupted:
        return _INTERRUPTED
    return {"INFEASIBLE": _IMPOSSIBLE, "NOT_FOUND": _NOT_FOUND}.get(route.verdict.value, _FOUND)


def _searched(task: SearchTask, changes: dict[str, Any], interrupted: list[int], *, quiet: bool) -> Route:
    """The answer, with the progress told."""
    limit = changes.get("time_limit", task.options.get("time_limit", 10.0))
    began = told = time.perf_counter()
    with reporter(quiet=quiet) as report:
        report.note("searching a way")

        def watch(nodes: int) -> bool:
            nonlocal told
            now = time.perf_counter()
            if now - told > _REPORT:
                told = now
                left = max(limit - (now - began), 0.0)
                report.count(f"{nodes} poses, {left:.0f} s left", round(10 * (limit - left)), round(10 * limit))
            return bool(interrupted)

        return task.route(watch=watch, **changes)


@contextlib.contextmanager
def _interruptible() -> Iterator[list[int]]:
    """A list that is no longer empty after Ctrl-C; a second one interrupts."""
    caught: list[int] = []

    def catch(number: int, _: Any) -> None:
        if caught:
            raise KeyboardInterrupt
        caught.append(number)

    try:
        before = signal.signal(signal.SIGINT, catch)
    except ValueError:  # not in the main thread
        yield caught
        return
    try:
        yield caught
    finally:
        signal.signal(signal.SIGINT, before)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 1e5:
        raise argparse.ArgumentTypeError(f"'{text}' is no time > 0 [s]")
    return value


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is no whole number ≥ 0")
    return int(text)


COMMANDS = (_add_route,)
