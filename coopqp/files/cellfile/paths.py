"""Paths in a cell file: relative to the file, with ``~``, environment variables and ``package://``."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath

from coopqp.errors import CoopqpError
from coopqp.model.description import find_package

_PACKAGE = "package://"


def folder_of(file: Path) -> Path:
    """The folder that paths in a file are relative to: its own, also where a link leads to the file."""
    return (file.resolve() if file.is_symlink() else file).parent


def resolve(text: str, folder: Path, where: str, *, package_dirs: Sequence[Path] = ()) -> Path:
    """The path that a text of a cell file means.

    Args:
        text: the text.
        folder: folder of the file.
        where: the key, for messages.
        package_dirs: folders that resolve ``package://``.

    Raises:
        CoopqpError: an environment variable is not set, there is no such package, or no home folder.
    """
    if text.startswith(_PACKAGE):
        name, _, rest = text.removeprefix(_PACKAGE).partition("/")
        found = find_package(name, folder, package_dirs) if name else None
        if found is None:
            raise CoopqpError(f"{where}: there is no package '{name}'. Give the folder above it in package_dirs.")
        return found / rest
    expanded = os.path.expandvars(os.path.expanduser(text))  # noqa: PTH111 Path.expanduser raises, and needs a Path
    missing = re.search(r"\$(\w+|\{[^}]*\})", expanded)
    if missing:
        raise CoopqpError(f"{where}: the environment variable {missing[0]} is not set. Set it, or write the path out.")
    if expanded.startswith("~"):
        raise CoopqpError(f"{where}: '{expanded.partition('/')[0]}' has no home folder. Write the path out.")
    return folder / expanded


def check_inside(text: str) -> str | None:
    """The fault of a folder that must lie below the working directory; None if it does."""
    for path in (PurePosixPath(text), PureWindowsPath(text)):
        if path.is_absolute() or path.drive or path.root or ".." in path.parts:
            return "give a folder below the working directory, without '..' (the option --out takes any folder)"
    if text.startswith("~") or "$" in text:
        return "give a folder below the working directory, without ~ and $ (the option --out takes any folder)"
    return None
