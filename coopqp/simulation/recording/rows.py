"""Rows of numbers of a long run: gathered in memory while they are few, then in a file; and archives of them.

An archive is an ordinary ``.npz`` file: :func:`numpy.load` reads it. Arrays of a large archive are not compressed. They
lie at multiples of 64 bytes, so that they are mapped into memory and read where they are looked at.
"""

from __future__ import annotations

import math
import mmap
import shutil
import struct
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, cast, final

import numpy as np
import numpy.typing as npt

from coopqp.checks import read_only
from coopqp.spatial import Array

#: Largest array that is gathered in memory [bytes]; a longer one goes on in a file.
MOST_IN_MEMORY = 8 * 2**20
#: Rows of a block, which is written at once, and of a part, which is read at once.
BLOCK_ROWS = 4096
#: Arrays in an archive begin at multiples of this number of bytes.
_ALIGNED = 64
#: Mark of a filler in the head of an archive's entry, as zipalign writes it; head of an entry; field of its true size.
_FILLER, _HEAD, _SIZES = 0xD935, 30, 20


@final
class Rows:
    """Rows of one shape. Beyond :data:`MOST_IN_MEMORY` they lie in a file without a name, which ends with them.

    The file is in the folder for temporary files (environment variable ``TMPDIR``).
    """

    def __init__(self, *shape: int) -> None:
        self._block: Array = np.empty((BLOCK_ROWS, *shape))
        self._filled, self._rows = 0, 0
        self._blocks: list[Array] = []
        self._file: IO[bytes] | None = None

    def append(self, row: Any) -> None:
        """Add one row."""
        self._block[self._filled] = row
        self._filled += 1
        self._rows += 1
        if self._filled == BLOCK_ROWS:
            self._put()

    def _put(self) -> None:
        filled = self._block[: self._filled]
        if self._file is None and self._rows * self._block[0].nbytes > MOST_IN_MEMORY:
            self._file = _file_without_name()
            for block in self._blocks:
                self._file.write(block.tobytes())
            self._blocks.clear()
        if self._file is None:
            self._blocks.append(filled.copy())
        else:
            self._file.write(filled.tobytes())
        self._filled = 0

    def array(self) -> Array:
        """All rows, read-only. Nothing is added afterwards."""
        if self._filled:
            self._put()
        shape = (self._rows, *self._block.shape[1:])
        if self._file is None:
            return read_only(np.concatenate(self._blocks) if self._blocks else np.empty(shape))
        self._file.flush()
        return _mapped(self._file, 0, shape)


def _file_without_name() -> IO[bytes]:
    import tempfile  # late: it imports much

    return cast(IO[bytes], tempfile.TemporaryFile())


def _mapped(file: Any, offset: int, shape: tuple[int, ...]) -> Array:
    return np.asarray(np.memmap(file, dtype="<f8", mode="r", offset=offset, shape=shape))


def release(array: npt.NDArray[Any]) -> None:
    """Give back the memory of a mapped array: it is read again where it is looked at. Other arrays stay."""
    base: Any = array
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)


def parts(count: int, arrays: Iterable[npt.NDArray[Any]]) -> Iterator[slice]:
    """Slices that cover ``count`` rows. After each one the memory of the mapped ``arrays`` is given back."""
    given = list(arrays)
    for start in range(0, count, BLOCK_ROWS):
        yield slice(start, min(start + BLOCK_ROWS, count))
        for array in given:
            release(array)


# -- archives ------------------------------------------------------------------------------------------------------


def write_archive(
    stream: IO[bytes], arrays: Mapping[str, npt.NDArray[Any]], *, compress: bool, between: Callable[[], None]
) -> None:
    """Write arrays as a ``.npz`` archive, one ``.npy`` each; ``between()`` is called before each.

    Numbers of an archive that is not compressed can be mapped.
    """
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            between()
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            if array.dtype.kind == "f" and not compress:
                entry.compress_type = zipfile.ZIP_STORED
                size = -(stream.tell() + _HEAD + len(entry.filename) + _SIZES + 4) % _ALIGNED
                entry.extra = struct.pack("<HH", _FILLER, size) + bytes(size)
            with archive.open(entry, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
            release(array)


def unpacked_bytes(file: Path) -> int:
    """Bytes that the compressed entries of an archive claim to unpack to. Others are as large as they are."""
    with zipfile.ZipFile(file) as archive:
        return sum(entry.file_size for entry in archive.infolist() if entry.compress_type != zipfile.ZIP_STORED)


def read_archive(file: Path, names: Iterable[str], perhaps: Iterable[str] = ()) -> dict[str, npt.NDArray[Any]]:
    """Arrays of numbers of a ``.npz`` archive, read-only, and single values of any type. Nothing in it is executed.

    Arrays of ``perhaps`` that the archive lacks are left out.

    Small arrays are read into memory. Large ones of 8-byte numbers are mapped, or unpacked into a file without a name.

    Raises:
        OSError, ValueError, KeyError, zipfile.BadZipFile, ...: not a recording, or damaged.
    """
    with zipfile.ZipFile(file) as archive:
        there = set(archive.namelist())
        wanted = [*names, *(name for name in perhaps if f"{name}.npy" in there)]
        return {name: _read_entry(archive, archive.getinfo(f"{name}.npy"), file) for name in wanted}


def _read_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, file: Path) -> npt.NDArray[Any]:
    with archive.open(entry) as member:
        head, begin = None, 0
        if entry.file_size > MOST_IN_MEMORY and np.lib.format.read_magic(member) == (1, 0):
            head, begin = np.lib.format.read_array_header_1_0(member), member.tell()
        if head is None or head[1] or head[2] != np.dtype("<f8"):
            member.seek(0)
            array: npt.NDArray[Any] = np.lib.format.read_array(member, allow_pickle=False)
            return array if array.ndim == 0 else read_only(array)
        shape = head[0]
        if min(shape) < 0 or 8 * math.prod(shape) != entry.file_size - begin:
            raise ValueError(f"'{entry.filename}' has {entry.file_size - begin} bytes for the shape {shape}")
        place = _place(file, entry) + begin
        if entry.compress_type == zipfile.ZIP_STORED and place % 8 == 0:
            return _mapped(file, place, shape)
        copy = _file_without_name()
        shutil.copyfileobj(member, copy)
        copy.flush()
        return _mapped(copy, 0, shape)


def _place(file: Path, entry: zipfile.ZipInfo) -> int:
    """Where the content of an entry begins in the file: after its head, its name and what fills it up."""
    with file.open("rb") as stream:
        stream.seek(entry.header_offset + _HEAD - 4)
        name, filler = struct.unpack("<HH", stream.read(4))
    return int(entry.header_offset + _HEAD + name + filler)
