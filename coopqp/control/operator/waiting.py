"""Calls that wait for the thread that steps: in a row without a break they cost a step one of each kind."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterator
from typing import Any, Generic, TypeVar, final

_T = TypeVar("_T")

#: Calls of which the last one alone decides, beside each call by its own name.
_KINDS = {
    "pause": "rest", "resume": "rest", "set_override": "rate", "gear": "rate", "reverse": "travel", "forward": "travel",
    "run_to": "travel", "step_to_mark": "travel", "engage": "hand", "release": "hand",
}  # fmt: skip

#: Calls that decide how fast the object goes, not where.
RATE_CALLS = frozenset({"pause", "resume", "set_override", "gear", "signal"})


def kind_of(call: str, value: Any = None) -> Hashable:
    """What a call of an operator decides, by its name; a signal is of a kind of its own, by its name."""
    return (call, value) if call == "signal" else _KINDS.get(call, call)


@final
class Waiting(Generic[_T]):
    """Calls by their kinds. Any thread and any signal handler puts them there; nobody waits for another."""

    def __init__(self) -> None:
        self._calls: deque[tuple[Hashable, _T]] = deque()
        self._due: deque[list[_T]] = deque()

    def __bool__(self) -> bool:
        return bool(self._due or self._calls)

    def put(self, kind: Hashable, call: _T) -> None:
        """A call of a kind, after all that wait."""
        self._calls.append((kind, call))

    def take(self) -> Iterator[list[_T]]:
        """The calls of each kind that wait now, the kind called last at the end; what comes meanwhile waits on.

        Those at which the taker stops come first the next time, ahead of all that wait by then.
        """
        yield from self._taken()
        found: dict[Hashable, list[_T]] = {}
        for _ in range(len(self._calls)):
            kind, call = self._calls.popleft()
            calls = found.pop(kind, [])
            calls.append(call)
            found[kind] = calls
        self._due.extend(found.values())
        yield from self._taken()

    def _taken(self) -> Iterator[list[_T]]:
        while self._due:
            yield self._due[0]
            self._due.popleft()
