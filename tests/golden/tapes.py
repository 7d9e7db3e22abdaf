"""What a controller did, step by step, as numbers and words: how it is written to a file, and when two are the same.

Numbers are written as multiples of 1e-10 and less. Of the steps of a run each is told by what the last ones let expect,
and configurations by the velocities that led to them: what is left are a few bits a number.
"""

from __future__ import annotations

import json
import lzma
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coopqp import ControlStep
from coopqp.spatial import Array

#: Numbers are multiples of this, and some of less: configurations are divided by the length of a step.
QUANTUM = 1e-10
QUANTA = {"q_next": 1e-12, "dt": 1e-13}
#: Largest difference of joint velocities [rad/s or m/s].
SAME = 1e-9
#: The same at a stop: there the rate is the root of what rounding leaves.
SAME_AT_REST = 1e-8
#: The same in fast turns and near singularities.
DISTURBED = 5e-8
#: A step hands on by how much the last ones differed, magnified where the rate falls to what the slowest joint can do.
MAGNIFIED = 2.0
#: Nothing may grow beyond this in a run [rad/s or m/s].
GROWN = 1e-6
#: Numbers of each step, and by how many times ``same`` they may differ.
NUMBERS = {
    "velocity": 1.0, "q_next": 1.0, "commanded_apart": 10.0, "rate": 100.0, "clock_next": 100.0, "dt": 0.0,
    "given_up.off_path": 1.0, "given_up.rate": 1e4, "given_up.grasp": 1e4, "given_up.path": 1e4, "given_up.chain": 1e4,
}  # fmt: skip
_NONE = np.iinfo(np.int64).min
#: A number within a sentence.
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@dataclass
class Tape:
    """One run: of each name in NUMBERS an array (n, width), and of each step its words, in the order of WORDS."""

    numbers: dict[str, Array]
    words: list[tuple[Any, ...]]

    @classmethod
    def of(cls, steps: Sequence[ControlStep]) -> Tape:
        """The tape of some steps."""
        return cls({name: _column(steps, name) for name in NUMBERS}, [_words(step) for step in steps])

    def __len__(self) -> int:
        return len(self.words)


WORDS = ("status", "cause", "binding", "finished", "kinds of numbers", "reason")


def _words(step: ControlStep) -> tuple[Any, ...]:
    """Whether a number is Python's own is seen where a recording is written as JSON."""
    kinds = {type(getattr(step, name)).__name__ for name in ("rate", "clock", "clock_next", "dt")}
    cause = step.cause.name if step.cause is not None else ""
    binding = "; ".join(str(limit) for limit in step.binding)
    return step.status.name, cause, binding, bool(step.finished), " ".join(sorted(kinds)), step.reason


def _column(steps: Sequence[ControlStep], name: str) -> Array:
    def value(step: Any) -> Any:
        for part in name.split("."):
            step = getattr(step, part)
        return step

    return np.array([value(step) for step in steps], dtype=float).reshape(len(steps), -1)


def same_words(one: Any, other: Any) -> bool:
    """Whether two texts are the same; a number in them may differ by one in its last place."""
    if one == other or not isinstance(one, str) or not isinstance(other, str):
        return bool(one == other)
    if _NUMBER.sub("#", one) != _NUMBER.sub("#", other):
        return False
    pairs = zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=True)
    return all(abs(float(a) - float(b)) <= 1.001 * 10.0 ** -len(a.partition(".")[2]) for a, b in pairs)


def difference(made: Tape, kept: Tape, same: Array) -> tuple[int, str] | None:
    """The first step whose numbers or words differ, and in what; None if none does.

    Args:
        made: what was done now.
        kept: what was recorded.
        same: what velocities of each step may differ by (n,).
    """
    n = min(len(made), len(kept))
    inherited = _inherited(made, kept, n)
    rest = kept.numbers["rate"][:n, 0] < 1e-6
    bound = same[:n] + inherited
    found = []
    for name, times in NUMBERS.items():
        near = np.maximum(same[:n], SAME_AT_REST) + inherited if name == "velocity" else bound
        near = np.where(rest, near, bound) * times + QUANTA.get(name, QUANTUM)
        apart = _apart(made, kept, name, n)
        if (over := ~(apart <= near[:, None]).all(axis=1)).any():  # of a number that is none no comparison is true
            i = int(np.argmax(over))
            found.append((i, f"{name} differs by {apart[i].max():.3g}, {near[i]:.3g} are allowed"))
    for i in range(n):
        other = [name for name, a, b in zip(WORDS, made.words[i], kept.words[i], strict=True) if not same_words(a, b)]
        if other:
            found.append((i, f"{other[0]} was {kept.words[i][WORDS.index(other[0])]!r}"))
            break
    if len(made) != len(kept):
        found.append((n, f"{len(kept)} steps were made, and now {len(made)}"))
    return min(found, default=None)


def _apart(made: Tape, kept: Tape, name: str, n: int) -> Array:
    a, b = made.numbers[name][:n], kept.numbers[name][:n]
    if a.shape[1] != b.shape[1]:
        return np.full((n, 1), np.nan)
    return np.where(np.isnan(a) & np.isnan(b), 0.0, np.abs(a - b))


def _inherited(made: Tape, kept: Tape, n: int) -> Array:
    """What each step may differ by because the last one did: a joint at its limit makes up in one step for what its
    positions differ by."""
    turn, place = (
        np.nan_to_num(np.maximum(_apart(made, kept, name, n).max(axis=1) - QUANTA.get(name, QUANTUM), 0.0), nan=np.inf)
        for name in ("velocity", "q_next")
    )
    handed = MAGNIFIED * turn[:-1] + place[:-1] / kept.numbers["dt"][1:n, 0]
    return np.minimum(np.concatenate([[0.0], handed]), GROWN)


# -- files -----------------------------------------------------------------------------------------------------------


@dataclass
class _Written:
    """Bytes of arrays, one after the other, and what is needed to read them again."""

    heads: list[dict[str, list[int]]] = field(default_factory=list)
    parts: list[bytes] = field(default_factory=list)


def to_bytes(tapes: Sequence[Tape]) -> tuple[bytes, bytes]:
    """Numbers and words of the runs of a case, to be kept."""
    written = _Written()
    for tape in tapes:
        head, whole = {}, _whole(tape)
        for name, x in whole.items():
            order = min(range(3), key=lambda k, x=x: float(np.log1p(np.abs(_less(x, k).astype(float))).sum()))
            left = _less(x, order)
            folded = np.where(left < 0, -2 * (left + 1) + 1, 2 * left).astype("<u8")
            planes = folded.T.reshape(-1).view(np.uint8).reshape(-1, 8).T
            used = int(max((i + 1 for i in range(8) if planes[i].any()), default=0))
            head[name] = [*x.shape, order, used]
            written.parts.append(planes[:used].tobytes())
        written.heads.append(head)
    numbers = json.dumps(written.heads).encode() + b"\n" + b"".join(written.parts)
    return lzma.compress(numbers, preset=9 | lzma.PRESET_EXTREME), _words_to_bytes(tapes)


def from_bytes(numbers: bytes, words: bytes) -> list[Tape]:
    """The runs of a case."""
    head, _, rest = lzma.decompress(numbers).partition(b"\n")
    said, found, at = _words_from_bytes(words), [], 0
    for shapes, own in zip(json.loads(head), said, strict=True):
        whole = {}
        for name, (n, width, order, used) in shapes.items():
            size = n * width
            planes = np.zeros((8, size), dtype=np.uint8)
            planes[:used] = np.frombuffer(rest, np.uint8, used * size, at).reshape(used, size)
            at += used * size
            folded = np.ascontiguousarray(planes.T).view("<u8").reshape(width, n).T
            left = np.where(folded & 1, -(folded >> 1).astype(np.int64) - 1, (folded >> 1).astype(np.int64))
            for _ in range(order):
                left = np.cumsum(left, axis=0)
            whole[name] = left
        found.append(Tape(_numbers(whole), own))
    return found


def _less(x: Array, order: int) -> Array:
    for _ in range(order):
        x = np.diff(x, axis=0, prepend=np.zeros_like(x[:1]))
    return x


def _whole(tape: Tape) -> dict[str, Array]:
    """Numbers as integers; of configurations what the velocities do not tell."""
    whole = {}
    for name, x in tape.numbers.items():
        scaled = np.rint(x / QUANTA.get(name, QUANTUM))
        whole[name] = np.where(np.isnan(scaled), _NONE, np.nan_to_num(scaled)).astype(np.int64)
    if whole["q_next"].shape == whole["velocity"].shape:
        whole["q_next"] -= _ways(whole)
    whole["given_up.rate"] += whole["rate"]
    return whole


def _numbers(whole: dict[str, Array]) -> dict[str, Array]:
    """What these integers stand for."""
    whole["given_up.rate"] -= whole["rate"]
    if whole["q_next"].shape == whole["velocity"].shape:
        whole["q_next"] += _ways(whole)
    return {name: np.where(x == _NONE, np.nan, x * QUANTA.get(name, QUANTUM)) for name, x in whole.items()}


def _ways(whole: dict[str, Array]) -> Array:
    """How far the velocities have moved the joints (n, nv)."""
    quanta = QUANTUM * QUANTA["dt"] / QUANTA["q_next"]
    return np.cumsum(np.rint(whole["velocity"] * (whole["dt"] * quanta)).astype(np.int64), axis=0)


def _words_to_bytes(tapes: Sequence[Tape]) -> bytes:
    """The different rows of words, and of each run which of them its steps have: [row, how many steps, …]."""
    rows: dict[tuple[Any, ...], int] = {}
    runs = []
    for tape in tapes:
        run: list[list[int]] = []
        for row in tape.words:
            i = rows.setdefault(row, len(rows))
            if run and run[-1][0] == i:
                run[-1][1] += 1
            else:
                run.append([i, 1])
        runs.append(run)
    return lzma.compress(
        json.dumps({"rows": list(rows), "runs": runs}, ensure_ascii=False, indent=0).encode(), preset=9
    )


def _words_from_bytes(words: bytes) -> Iterable[list[tuple[Any, ...]]]:
    read = json.loads(lzma.decompress(words))
    rows = [tuple(row) for row in read["rows"]]
    return [[rows[i] for i, times in run for _ in range(times)] for run in read["runs"]]
