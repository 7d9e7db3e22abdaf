"""The journal of a study: a line for every finished row, which is on the disk before the next row is sent.

A line is a JSON object whose last entry ``crc`` is the CRC-32 of the line without it: a line that was changed is found.
"""

from __future__ import annotations

import contextlib
import json
import os
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, final

from coopqp.errors import OutputError, said
from coopqp.reading import check_depth, open_file, read_file
from coopqp.studies.errors import StudyError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def read_journal(file: Path) -> tuple[list[dict[str, Any]], int]:
    """The entries of a journal, and the length of its complete lines [bytes]: a last line may be cut.

    Raises:
        StudyError: a line inside it is damaged, or it is no ordinary file.
    """
    try:
        content = read_file(file, _MOST_BYTES)
    except FileNotFoundError:
        content = b""
    except OSError as error:
        raise StudyError(f"cannot read {error.filename}: {error.strerror}. Give another folder.") from error
    whole = content[: content.rfind(b"\n") + 1]
    return [_entry(line, f"{file}, line {i}") for i, line in enumerate(whole.split(b"\n")[:-1], start=1)], len(whole)


#: Largest accepted journal [bytes], and nesting depth of its entries.
_MOST_BYTES, _MOST_DEPTH = 2_000_000_000, 50
#: What helps where a journal is damaged.
ANEW = "Start the study anew in another folder, or take this line and those after it out: their rows are run again."
_MARK = b', "crc": "'


def _line(entry: dict[str, Any]) -> bytes:
    text = json.dumps(entry, ensure_ascii=False).encode()
    return text[:-1] + _MARK + f'{zlib.crc32(text):08x}"}}\n'.encode()


def _entry(line: bytes, where: str) -> dict[str, Any]:
    """The entry of a line.

    Raises:
        StudyError: it is not as it was written.
    """
    head, _, tail = line.rpartition(_MARK)
    text = head + b"}"
    if tail != f'{zlib.crc32(text):08x}"}}'.encode():
        raise StudyError(f"{where} is damaged (its checksum is another). {ANEW}")
    try:
        entry: dict[str, Any] = json.loads(text)
        check_depth(entry, _MOST_DEPTH)
        if not isinstance(entry, dict):
            raise TypeError("it is no table")
    except (ValueError, TypeError, RecursionError) as error:  # whoever wrote it knows checksums
        raise StudyError(f"{where} is damaged ({said(error)}). {ANEW}") from error
    return entry


@final
class Journal:
    """A journal that is written. One program at a time can write it.

    Args:
        file: the journal; a line that was cut is taken off.

    Raises:
        StudyError: another program writes it, or it is damaged.
        OutputError: it cannot be written.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        try:
            with contextlib.suppress(FileNotFoundError):
                open_file(file, _MOST_BYTES).close()  # to write a pipe would be waited for
            self._stream = file.open("ab", buffering=0)
        except OSError as error:
            raise OutputError(f"cannot write {file}: {error.strerror}. Check the folder.") from error
        try:
            if fcntl is not None:
                fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.entries, size = read_journal(file)
            self._stream.truncate(size)
        except BlockingIOError as error:
            self._stream.close()
            raise StudyError(f"another program writes {file}. Wait until it ends.") from error
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def append(self, entries: Iterable[dict[str, Any]]) -> None:
        """Write entries, and wait until the disk has them.

        Raises:
            OutputError: they cannot be written. Earlier ones stay.
        """
        text = b"".join(map(_line, entries))
        try:
            rest = memoryview(text)
            while rest:
                rest = rest[self._stream.write(rest) :]
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise OutputError(
                f"cannot write {self.file}: {error.strerror}. Finished rows are kept: make room, then use --resume."
            ) from error
