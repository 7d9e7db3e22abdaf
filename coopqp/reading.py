"""Files that may come from strangers: ordinary ones of a bounded size are read, and nothing else is waited for."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO

#: A path with more characters is shortened in errors.
_LONG = 500


def open_file(file: str | Path, most: int) -> IO[bytes]:
    """Open an ordinary file: no folder, no device, no pipe, whose reader would wait or never end.

    Args:
        file: its path.
        most: largest accepted size [bytes].

    Raises:
        OSError: it is missing, cannot be read, is no ordinary file or too large: ``strerror`` says why, in words, and
            ``filename`` is the path, which may be shortened.
    """
    with _named(file):
        handle = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # without O_NONBLOCK a pipe is waited for
        try:
            found = os.fstat(handle)
            if not stat.S_ISREG(found.st_mode):
                if stat.S_ISDIR(found.st_mode):
                    raise OSError(errno.EISDIR, "it is a folder")
                raise OSError(errno.EINVAL, "it is no ordinary file")
            if found.st_size > most:
                raise OSError(errno.EFBIG, f"it is larger than {most} bytes")
            return open(handle, "rb")  # noqa: PTH123
        except BaseException:
            os.close(handle)
            raise


def read_file(file: str | Path, most: int) -> bytes:
    """The content of an ordinary file. Arguments and errors as of :func:`open_file`."""
    with open_file(file, most) as stream, _named(file):
        content = stream.read(most + 1)  # the system tells the size 0 of some files that do not end
        if len(content) > most:
            raise OSError(errno.EFBIG, f"it is larger than {most} bytes")
    return content


@contextlib.contextmanager
def _named(file: str | Path) -> Iterator[None]:
    said = str(file) if len(str(file)) <= _LONG else f"{str(file)[:60]}…"
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, said) from error
    except ValueError as error:  # a null character, a surrogate
        raise OSError(errno.EINVAL, "this is no path of a file", said) from error


def check_depth(value: object, most: int) -> None:
    """Raise ValueError if tables and lists are nested deeper than ``most``: whoever follows them is recursive."""
    level, depth = [value], 0
    while level:
        if depth > most:
            raise ValueError(f"it is nested more than {most} deep")
        inner: list[object] = []
        for entry in level:
            if isinstance(entry, dict):
                inner += entry.values()
            elif isinstance(entry, list):
                inner += entry
        level, depth = inner, depth + 1
