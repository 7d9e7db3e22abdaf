"""Atomic writes: all files are written completely, or none is."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import IO, Any, final

from coopqp.errors import OutputError


def check_folder(folder: Path) -> None:
    """Raise OutputError unless ``folder`` is writable or can be created. Creates nothing."""
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise OutputError(f"cannot write into {folder}: {existing} is a file, not a folder. Give another folder.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write into {folder}: no permission on {existing}. Give another folder.")


def check_below(folder: Path) -> None:
    """Raise OutputError unless ``folder`` lies below the working directory, links followed. Creates nothing."""
    try:
        place, here = folder.resolve(), Path.cwd().resolve()
        if any(part.is_symlink() for part in (place, *place.parents)):  # links in a circle, from Python 3.13 on
            raise OSError("its links lead nowhere")
    except (OSError, RuntimeError) as error:  # links in a circle, before
        raise OutputError(f"cannot write into {folder}: {error}. Give another folder with --out.") from error
    if not place.is_relative_to(here):
        raise OutputError(
            f"{folder} leads to {place}, out of the working directory, and nothing was written. "
            "Give --out, which takes any folder."
        )


def check_bag(folder: Path) -> None:
    """Raise OutputError if the folder of a bag exists, or cannot be created. Creates nothing."""
    if folder.exists():
        raise OutputError(f"cannot write the bag {folder}: it exists. Remove it, or give another folder.")
    check_folder(folder.parent)


def check_file(file: Path) -> None:
    """Raise OutputError unless ``file`` can be written, or created with its folder. Creates nothing."""
    if file.is_dir():
        raise OutputError(f"cannot write {file}: it is a folder. Give the name of a file.")
    check_folder(file.parent)


def check_new(*files: Path | None, force: bool = False) -> None:
    """As :func:`check_file` for each file that is given; also raise OutputError if it exists, unless ``force``."""
    for file in files:
        if file is not None:
            check_file(file)
            check_unused([file], force=force)


def check_unused(files: Iterable[Path], *, force: bool = False) -> None:
    """Raise OutputError if one of ``files`` exists, unless ``force``."""
    used = next((file for file in files if file.exists()), None)
    if used is not None and not force:
        raise OutputError(f"{used} exists. Replace it with --force, or give another place.")


def numbered(wanted: Path, is_used: Callable[[Path], bool], *, suffix: str = "") -> Path:
    """``wanted``, or the first of ``NAME-2``, ``NAME-3``, … (before a ``suffix``) that is not used."""
    place, number = wanted, 1
    stem = wanted.name.removesuffix(suffix)
    while is_used(place):
        number += 1
        place = wanted.with_name(f"{stem}-{number}{suffix}")
    return place


@final
class Interrupts:
    """A block in which Ctrl-C waits until its end, except in the part under :meth:`let_through`.

    There the first Ctrl-C has its usual effect, and nothing interrupts the clean-up after it. In threads,
    which no Ctrl-C interrupts, this does nothing.
    """

    def __init__(self) -> None:
        self._before: Callable[[int, FrameType | None], object] | None = None
        self._waiting: list[tuple[int, FrameType | None]] = []
        self._open = False

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            before = signal.getsignal(signal.SIGINT)
            if callable(before):  # else it is ignored, or set from outside of Python
                self._before = before
                signal.signal(signal.SIGINT, self._take)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)
            if self._waiting:
                self._before(*self._waiting[0])

    def _take(self, number: int, frame: FrameType | None) -> None:
        if self._open and self._before is not None:
            self._open = False
            self._before(number, frame)
        else:
            self._waiting.append((number, frame))

    def check(self) -> None:
        """Let a Ctrl-C that waits have its effect now."""
        if self._waiting and self._before is not None:
            self._before(*self._waiting.pop())

    @contextlib.contextmanager
    def let_through(self) -> Iterator[None]:
        """The part that Ctrl-C may end."""
        self._open = True
        try:
            self.check()
            yield
        finally:
            self._open = False


@contextlib.contextmanager
def folder_of(file: Path) -> Iterator[None]:
    """Make the folder of a file for as long as it is written. A failure or an interrupt leaves no empty folder.

    Raises:
        OutputError: a folder cannot be made.
    """
    made: list[Path] = []
    with Interrupts() as interrupts:
        try:
            _make_folders(file.parent, made)
            with interrupts.let_through():
                yield
        except FileExistsError as error:
            raise OutputError(f"cannot make {file.parent}: {error.strerror}. Give another folder.") from error
        except OSError as error:
            raise OutputError(f"cannot write {error.filename or file}: {error.strerror}. Check the folder.") from error
        finally:
            _remove_empty(made)


def _make_folders(folder: Path, made: list[Path]) -> None:
    for place in reversed([place for place in (folder, *folder.parents) if not place.exists()]):
        made.append(place)
        place.mkdir(exist_ok=True)


def _remove_empty(folders: list[Path]) -> None:
    for place in reversed(folders):
        with contextlib.suppress(OSError):  # it is not empty: something was written
            place.rmdir()


@contextlib.contextmanager
def whole_file(file: Path) -> Iterator[IO[bytes]]:
    """A stream to write a file of any size; its folder is made. A failure or an interrupt leaves what was there.

    Raises:
        OutputError: the file cannot be written.
    """
    check_file(file)
    temporary = temporary_name(file)
    with Interrupts() as interrupts, folder_of(file):
        try:
            with temporary.open("xb") as stream, interrupts.let_through():
                yield stream
            temporary.replace(file)
        except OSError as error:
            raise OutputError(f"cannot write {error.filename or file}: {error.strerror}. Check the folder.") from error
        finally:
            temporary.unlink(missing_ok=True)


def temporary_name(file: Path) -> Path:
    """A hidden name beside a file or folder, until it is complete and renamed."""
    return file.with_name(f".{file.name}.{os.urandom(4).hex()}.tmp")


def json_bytes(value: Any) -> bytes:
    """Plain values as the bytes of a JSON file."""
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()


def write_files(contents: Mapping[Path, bytes]) -> list[Path]:
    """Write files and create their folders.

    Each file is first written under a temporary name in its folder. When all are complete, they are renamed. A failure
    or an interrupt leaves no partial file. Ctrl-C waits until the files are written.

    Returns:
        The files, in the order given.

    Raises:
        OutputError: a folder or a file cannot be written.
    """
    staged: list[tuple[Path, Path]] = []
    with Interrupts(), contextlib.ExitStack() as folders:
        try:
            for file, content in contents.items():
                check_file(file)
                folders.enter_context(folder_of(file))
                temporary = temporary_name(file)
                staged.append((temporary, file))
                with temporary.open("xb") as stream:
                    stream.write(content)
            for temporary, file in staged:
                temporary.replace(file)
        except OSError as error:
            raise OutputError(f"cannot write {error.filename or file}: {error.strerror}. Check the folder.") from error
        finally:
            for temporary, _ in staged:
                temporary.unlink(missing_ok=True)
    return list(contents)
