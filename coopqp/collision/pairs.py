"""Which bodies may not come close to each other, and how close."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final
from xml.etree import ElementTree

from coopqp.checks import as_count
from coopqp.errors import InvalidInputError, UnknownNameError, nearest, shown
from coopqp.model.description import MAX_DESCRIPTION_BYTES
from coopqp.reading import read_file


@final
@dataclass(frozen=True, kw_only=True)
class PairRules:
    """Rules that leave pairs out: bodies that touch by design, or cannot meet.

    Attributes:
        apart: least number of joints between two links of one arm whose distance counts. A link that is fixed to the
            world is of all arms of its robot on whose way to the tool it lies, and of all if it lies on none.
        object_apart: least number of joints between the object and a link of an arm that holds it, for their distance
            to count. The link at the grasp has 0.
    """

    apart: int = 3
    object_apart: int = 2

    def __post_init__(self) -> None:
        for name in ("apart", "object_apart"):
            object.__setattr__(self, name, as_count(getattr(self, name), f"PairRules: {name}"))


@final
class Names:
    """The names of the bodies of a scene, and what patterns stand for them: a body, all links of an arm, ``"*"``.

    ``copies`` are names that some bodies have beside their own.
    """

    def __init__(self, names: Collection[str], arms: Sequence[str], copies: Mapping[str, str] | None = None) -> None:
        self.names, self._arms, self.copies = tuple(dict.fromkeys(names)), arms, copies or {}

    def pair(self, first: str, second: str) -> frozenset[str]:
        """A pair of bodies, by their own names."""
        return frozenset((self.copies.get(first, first), self.copies.get(second, second)))

    def matching(self, pattern: Any, where: str) -> frozenset[str]:
        """The bodies that a pattern stands for.

        Raises:
            UnknownNameError: the pattern stands for no body.
        """
        if pattern == "*":
            return frozenset(self.names)
        if pattern in self.names:
            return frozenset([pattern])
        if pattern in self._arms:
            return frozenset(name for name in self.names if name.startswith(f"{pattern}/"))
        near = nearest(str(pattern), [*self.names, *self._arms], most=12, cutoff=0.0)
        raise UnknownNameError("body", shown(pattern).strip("'"), near, where)

    def pairs(self, patterns: Iterable[Any], where: str) -> set[frozenset[str]]:
        """All pairs of names that pairs of patterns stand for.

        Raises:
            InvalidInputError, UnknownNameError: an entry is no pair of known names.
        """
        found: set[frozenset[str]] = set()
        for entry in patterns:
            first, second = as_pair(entry, where)
            others = self.matching(second, where)
            found |= {self.pair(a, b) for a in self.matching(first, where) for b in others}
        return found


def as_pair(entry: Any, where: str) -> tuple[str, str]:
    """Two names.

    Raises:
        InvalidInputError: the entry is something else.
    """
    if isinstance(entry, (str, bytes)) or not hasattr(entry, "__len__") or len(entry) != 2:
        raise InvalidInputError(f"{shown(entry)} is no pair of names", where, 'Give pairs such as ("object", "post").')
    first, second = entry
    return first, second


def ignored_line(pairs: Iterable[Sequence[str]]) -> str:
    """The line of a cell file by which pairs of names may touch."""
    return f"ignored = {json.dumps([list(pair) for pair in pairs], ensure_ascii=False)}"


def pairs_said(pairs: Iterable[Sequence[str]]) -> str:
    """Pairs of names for a sentence: "a and b with object, c with d"."""
    groups: dict[str, list[str]] = {}
    for first, second in pairs:
        groups.setdefault(second, []).append(first)
    return ", ".join(f"{' and '.join(firsts)} with {second}" for second, firsts in groups.items())


def srdf_pairs(source: str | Path, where: str) -> list[tuple[str, str]]:
    """Pairs of links that an SRDF switches off, as it names them. ``source`` is a file, or the text itself.

    Raises:
        InvalidInputError: no such file, or no SRDF.
    """
    text = str(source)
    if "<" not in text:
        try:
            text = read_file(text, MAX_DESCRIPTION_BYTES).decode("utf-8-sig", errors="replace")
        except FileNotFoundError as error:
            why = f"there is no file {error.filename}"
            raise InvalidInputError(why, where, "Give the path of an SRDF, or its text.") from error
        except OSError as error:
            why = f"cannot read {error.filename}: {error.strerror}"
            raise InvalidInputError(why, where, "Give the path of an SRDF.") from error
    if "<!ENTITY" in text:
        raise InvalidInputError("an SRDF that declares XML entities", where, "Write their text out.")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InvalidInputError(f"no readable SRDF ({error})", where, "Give an SRDF.") from error
    if root.tag != "robot":
        raise InvalidInputError(f"its root is <{root.tag}>, not <robot>", where, "Give an SRDF.")
    entries = [*root.iter("disable_collisions"), *root.iter("disable_collision")]
    return [(e.attrib["link1"], e.attrib["link2"]) for e in entries if {"link1", "link2"} <= e.attrib.keys()]
