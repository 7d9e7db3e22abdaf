"""Atomic writes: all files are written completely, or none is."""

from __future__ import annotations

import os
import secrets
from collections.abc import Mapping
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
    try:
        for file, content in contents.items():
            check_file(file)
            file.parent.mkdir(parents=True, exist_ok=True)
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
    return list(contents)
