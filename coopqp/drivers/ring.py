"""Rings in shared memory: one process writes rows or objects and waits for nobody, others read and count losses.

The memory is a file without a name: only a process that its maker starts gets it, and nothing is left of a killed run.
"""

from __future__ import annotations

import os
import pickle
import tempfile
from pathlib import Path
from typing import Any, final

import numpy as np

from coopqp.checks import as_count
from coopqp.spatial import Array

#: Numbers before the rows: rows written so far, and whether more will come.
_HEAD = 2


@final
class RowRing:
    """A ring of rows in shared memory. Its maker writes; who gets it reads.

    A process of ``multiprocessing`` gets it among its arguments. Another child gets its ``handle`` by ``pass_fds``.

    Args:
        width: numbers in a row.
        slots: rows that are kept.
        handle: of a ring that another process has made; None to make one.

    Attributes:
        handle: number of its file in this process.
        lost: rows that were written over before they were read.
    """

    def __init__(self, width: int, slots: int, *, handle: int | None = None) -> None:
        self.width, self.slots = as_count(width, "RowRing: width"), as_count(slots, "RowRing: slots")
        if handle is None:
            self._file = tempfile.TemporaryFile(dir=_folder(), buffering=0)  # noqa: SIM115  # closed by close()
            self._file.truncate(8 * (_HEAD + self.width * self.slots))
        else:
            os.set_inheritable(handle, False)
            self._file = open(handle, "r+b", buffering=0)  # noqa: SIM115, PTH123
        self.handle = self._file.fileno()
        self._head = np.memmap(self._file, np.int64, "r+", shape=(_HEAD,))
        self._rows = np.memmap(self._file, float, "r+", offset=8 * _HEAD, shape=(self.slots, self.width))
        self._next = 0
        self.lost = 0

    def __reduce__(self) -> Any:
        from multiprocessing.reduction import DupFd  # late: it imports much

        return _passed, (DupFd(self.handle), self.width, self.slots)

    @property
    def written(self) -> int:
        """Rows written so far."""
        return int(self._head[0])

    @property
    def ended(self) -> bool:
        """Whether no more rows will come."""
        return bool(self._head[1])

    def row(self) -> Array:
        """The row that comes next (width,), to be filled in before :meth:`push`."""
        return self._rows[int(self._head[0]) % self.slots]

    def push(self) -> None:
        """The row of :meth:`row` is complete."""
        self._head[0] += 1

    def end(self) -> None:
        """No more rows will come."""
        self._head[1] = 1

    def read(self) -> Array:
        """The rows since the last call (m, width); those that were written over meanwhile are counted in ``lost``."""
        count = self.written
        first = max(self._next, count - self.slots + 1)
        rows = self._rows[np.arange(first, count) % self.slots].copy()
        # The writer may have gone on, and be in the middle of the next row.
        kept = min(max(first, self.written - self.slots + 1), count)
        self.lost += kept - self._next
        self._next = count
        return rows[kept - first :]

    def close(self) -> None:
        """Close its file; the memory is given back with the last process that uses it."""
        self._file.close()


def _passed(file: Any, width: int, slots: int) -> RowRing:
    """The ring in a process that got it."""
    return RowRing(width, slots, handle=file.detach())


@final
class ObjectRing:
    """A ring of objects in shared memory: its maker tells them, a process that gets it takes the newest.

    Args:
        size: largest pickled object [bytes].
        slots: objects that are kept.
    """

    def __init__(self, *, size: int = 65_536, slots: int = 8) -> None:
        self._ring = RowRing(1 + -(-size // 8), slots)

    @property
    def ended(self) -> bool:
        """Whether no more objects will come."""
        return self._ring.ended

    def tell(self, value: object) -> None:
        """Put an object into the ring; one that is too large is left out."""
        packed = np.frombuffer(pickle.dumps(value), np.uint8)
        row = self._ring.row()
        if packed.size <= 8 * (row.size - 1):
            row[0] = packed.size
            row[1:].view(np.uint8)[: packed.size] = packed
            self._ring.push()

    def newest(self) -> Any:
        """The newest object that was not taken yet; None if there is none."""
        rows = self._ring.read()
        if not len(rows):
            return None
        return pickle.loads(rows[-1, 1:].view(np.uint8)[: int(rows[-1, 0])].tobytes())

    def end(self) -> None:
        """No more objects will come."""
        self._ring.end()

    def close(self) -> None:
        """As :meth:`RowRing.close`."""
        self._ring.close()


def _folder() -> str | None:
    """A folder whose files are in memory, where the system has one."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None
