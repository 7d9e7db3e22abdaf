"""Progress output of the command: a bar on a terminal, plain lines elsewhere, nothing if quiet."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from coopqp.errors import printable

if TYPE_CHECKING:
    import argparse

    from rich.progress import Progress


def add_command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], *, force: str = "", **texts: str
) -> argparse.ArgumentParser:
    """The parser of a subcommand, with ``--quiet``, and with ``--force`` where it overwrites what the text says."""
    parser: argparse.ArgumentParser = commands.add_parser(name, **texts)
    if force:
        parser.add_argument("--force", action="store_true", help=f"overwrite {force}")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    parser.set_defaults(run=run)
    return parser


def say(*texts: object) -> None:
    """One line on stderr, as all messages of the command: ``coopqp: …``."""
    sys.stdout.flush()
    print("coopqp:", *(printable(" ".join(str(text).split())) for text in texts), file=sys.stderr, flush=True)


class Reporter:
    """Receives progress reports. This base class prints nothing."""

    def note(self, text: str) -> None:
        """Report the present stage."""

    def step(self, label: str, done: int, planned: int) -> None:
        """Report ``done`` of ``planned`` steps of ``label``. A slowed run takes more steps than planned."""

    def count(self, label: str, done: int, total: int) -> None:
        """Report that ``done`` of ``total`` parts of equal cost are there."""


class _Lines(Reporter):
    """Prints one plain line on stderr at the beginning of each stage, and after each tenth of the items."""

    def __init__(self) -> None:
        self._begun: tuple[float, int] | None = None
        self._tenth = -1

    def note(self, text: str) -> None:
        print(printable(text), file=sys.stderr, flush=True)

    def step(self, label: str, done: int, planned: int) -> None:
        if done == 1:
            self.note(f"running {label}")

    def count(self, label: str, done: int, total: int) -> None:
        now = time.monotonic()
        begun, first = self._begun = self._begun or (now, done)
        tenth = 10 * done // max(total, 1)
        if tenth > self._tenth:
            self._tenth = tenth
            left = (now - begun) / (done - first) * (total - done) if done > first else 0.0
            more = f", about {left:.0f} s left" if left >= 1.0 else ""
            self.note(f"{label}: {done} of {total}{more}")


def _unstyled(text: str) -> str:
    """Text without control characters; rich reads ``[bold]`` as markup."""
    return printable(text).replace("[", "\\[")


class _Bar(Reporter):
    """Shows a progress bar of rich."""

    def __init__(self, bar: Progress, total: int | None) -> None:
        self._bar, self._task = bar, bar.add_task("", total=total)
        self._total = total

    def note(self, text: str) -> None:
        self._bar.update(self._task, description=_unstyled(text))

    def count(self, label: str, done: int, total: int) -> None:
        self._bar.update(self._task, completed=done, total=total, description=_unstyled(label))

    def step(self, label: str, done: int, planned: int) -> None:
        if self._total is None:
            self._total = planned
            self._bar.update(self._task, total=planned)
        # A slowed run takes more steps than planned. The bar does not count them.
        self._bar.update(self._task, advance=float(done <= planned), description=_unstyled(label))


@contextlib.contextmanager
def reporter(total: int | None = None, *, quiet: bool = False, remaining: bool = False) -> Iterator[Reporter]:
    """A progress bar on a terminal, plain lines elsewhere, nothing if quiet.

    Args:
        total: total number of steps; by default ``planned`` of the first report.
        quiet: print nothing.
        remaining: also show the time that is left.
    """
    if quiet or not sys.stderr.isatty():
        yield Reporter() if quiet else _Lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description:<31}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()) if remaining else (TimeElapsedColumn(),)
    with Progress(*columns, *times, console=Console(stderr=True), transient=True) as bar:
        yield _Bar(bar, total)


def styled(text: str, *codes: int, stream: TextIO | None = None) -> str:
    """Text with ANSI codes if the stream (default stdout) is a terminal and NO_COLOR is not set."""
    out = sys.stdout if stream is None else stream
    if not codes or not out.isatty() or "NO_COLOR" in os.environ:
        return text
    return f"\033[{';'.join(map(str, codes))}m{text}\033[0m"


#: ANSI codes for :func:`styled`.
BOLD, GREEN, RED = 1, 32, 31


def print_written(files: Sequence[Path], *, apart: bool = False, quiet: bool = False) -> None:
    """Print the files that were written, if there are any and unless ``quiet``; ``apart``: after an empty line."""
    if files and not quiet:
        print("\nwritten:" if apart else "written:", *(printable(str(file)) for file in files), sep="\n  ")


def print_hints(hints: Sequence[str]) -> None:
    """Print questions about a file on stderr."""
    for hint in hints:
        say("hint:", hint)


def print_table(lines: Sequence[Sequence[str]], *, numeric: Sequence[bool], head: bool = True) -> None:
    """Print rows in columns, with numbers to the right and the head in bold."""
    lines = [[printable(text) for text in line] for line in lines]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for i, line in enumerate(lines):
        padded = (t.rjust(w) if n else t.ljust(w) for t, w, n in zip(line, widths, numeric, strict=True))
        print(styled("  ".join(padded).rstrip(), *((BOLD,) if head and i == 0 else ())))
