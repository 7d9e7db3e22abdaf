from collections.abc import Callable
from typing import Any

from coopqp.spatial import Array

def follow(rooms: Array, reach: Array, positions: Array, x: Array, continuous: Array, /) -> None: ...
def certify(rooms: Array, reach: Array, spare: float, shares: Array, out: Array, /) -> bool: ...
def near(rooms: Array, watch: Array, /) -> list[int]: ...
def soonest(rooms: Array, most: Array, least: float, /) -> int: ...
def rows(
    ends: Array,
    J: Array,
    kinds: Array,
    rooms: Array,
    pairs: list[int],
    approach: float,
    G: Array,
    lower: Array,
    /,
) -> None: ...
def binding(G: Array, lower: Array, fastest: Array, /) -> list[int]: ...

class Nearby:
    def __init__(
        self,
        arrays: tuple[Array, ...],
        numbers: tuple[float, ...],
        owner: object,
        placing: tuple[tuple[Callable[..., Any], tuple[Any, ...]], ...],
        ask: Callable[..., Any],
        questions: list[tuple[Any, ...]],
        answers: list[Any],
        points: list[Callable[[], Array]],
        normals: list[Array],
        /,
    ) -> None: ...
    def rows(self, blind: bool, /) -> int: ...
    def tightened(self) -> bool: ...
    def doubtful(self, place: int, /) -> list[int] | None: ...
    def prepare(self) -> None: ...
    def surveys(self) -> bool: ...
