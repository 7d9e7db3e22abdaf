"""Atomic writes: all files are written completely, or none is."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from coopqp.errors import CoopqpError


class OutputError(CoopqpError):
    """A file or folder cannot be written."""


def check_folder(folder: Path) -> None:
    """Raise OutputError unless ``folder`` is writable or can be created. Creates nothing."""
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise OutputError(f"cannot write into {folder}: {existing} is a file, not a folder. Give another folder.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write into {folder}: no permission on {existing}. Give another folder.")


def check_file(file: Path) -> None:
    """Raise OutputError unless ``file`` can be written, or created with its folder. Creates nothing."""
    if file.is_dir():
        raise OutputError(f"cannot write {file}: it is a folder. Give the name of a file.")
    check_folder(file.parent)


def check_new(file: Path, *, force: bool = False) -> None:
    """As :func:`check_file`; also raise OutputError if ``file`` exists, unless ``force``."""
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


@contextlib.contextmanager
def folder_of(file: Path) -> Iterator[None]:
    """Make the folder of a file for as long as it is written. A failure or an interrupt leaves no empty folder.

    Raises:
        OutputError: a folder cannot be made.
    """
    made: list[Path] = []
    folder = file.parent
    missing = [folder, *folder.parents]
    missing = [place for place in missing if not place.exists()]
    try:
        for place in reversed(missing):
            made.append(place)
            place.mkdir(exist_ok=True)
        yield
    except FileExistsError as error:
        raise OutputError(f"cannot make {folder}: {error.strerror}. Give another folder.") from error
    except OSError as error:
        raise OutputError(f"cannot write {error.filename or file}: {error.strerror}. Check the folder.") from error
    finally:
        for place in reversed(made):
            with contextlib.suppress(OSError):  # it is not empty: something was written
                place.rmdir()


def write_files(contents: Mapping[Path, bytes]) -> list[Path]:
    """Write files and create their folders.

    Each file is first written under a temporary name in its folder. When all are complete, they are renamed. A failure
    leaves no partial file.

    Returns:
        The files, in the order given.

    Raises:
        OutputError: a folder or a file cannot be written.
    """
    staged: list[tuple[Path, Path]] = []
    with contextlib.ExitStack() as folders:
        _write(contents, staged, folders)
    return list(contents)


def _write(contents: Mapping[Path, bytes], staged: list[tuple[Path, Path]], folders: contextlib.ExitStack) -> None:
    try:
        for file, content in contents.items():
            check_file(file)
            folders.enter_context(folder_of(file))
            temporary = file.with_name(f".{file.name}.{secrets.token_hex(4)}.tmp")
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
