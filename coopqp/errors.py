"""Errors: one root class. Each message names the problem, its place and a remedy."""

from __future__ import annotations

import difflib
import itertools
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any


class CoopqpError(Exception):
    """Root of every error that coopqp raises. A message is bounded, also where it has a stranger's names."""

    def __str__(self) -> str:
        return _bounded(super().__str__())


class InvalidInputError(CoopqpError, ValueError):
    """An invalid value. The message names the problem, the place and the remedy."""

    def __init__(self, what: str, where: str, remedy: str) -> None:
        super().__init__(f"{where}: {what}. {remedy}")
        self.what, self.where, self.remedy = what, where, remedy

    def __reduce__(self) -> tuple[type[InvalidInputError], tuple[str, str, str]]:
        return type(self), (self.what, self.where, self.remedy)


class UnknownNameError(CoopqpError, KeyError):
    """An unknown name. The message lists the valid names, the nearest one first."""

    def __init__(self, kind: str, name: str, available: Iterable[str], where: str = "") -> None:
        self.kind, self.name, self.available = kind, name, tuple(available)
        said = shortened(f"'{printable(name)}'")
        near = nearest(name, self.available)
        hint = f" Did you mean '{shortened(near[0])}'?" if near else ""
        at = f" in {where}" if where else ""
        self.message = f"no {kind} named {said}{at}.{hint} Available: {listed(self.available) or 'none'}."
        self._where = where
        super().__init__(self.message)

    def __str__(self) -> str:
        return _bounded(self.message)

    def __reduce__(self) -> tuple[type[UnknownNameError], tuple[str, str, tuple[str, ...], str]]:
        return type(self), (self.kind, self.name, self.available, self._where)


class OutputError(CoopqpError):
    """A file or folder cannot be written."""


class ModelError(CoopqpError):
    """A robot model cannot be read, or no arm can be built from it."""


class StartWarning(UserWarning):
    """A controller starts where it may, but something is odd: joints outside limits, arms off the grasp or the path."""


class StiffnessWarning(UserWarning):
    """Arms that hold one object are measured without their servos' stiffness: one that stops may be seen late."""


class BusyError(CoopqpError, RuntimeError):
    """A controller was called while another thread computes its step: a misuse of the program. Nothing was changed."""

    def __init__(
        self, message: str = "another thread computes a step of this controller. Give each thread its own."
    ) -> None:
        super().__init__(message)


class UnreachableError(CoopqpError):
    """An arm cannot reach a pose."""


class LooseObjectError(UnreachableError):
    """Grasps that give way leave the object loose: it moves although all tools that hold it rest."""


class NoStartError(UnreachableError):
    """Arms have no start from which they follow a path. The message names arm, joint, amount and remedy."""

    def __init__(self, arms: tuple[str, ...], message: str) -> None:
        super().__init__(message)
        self.arms, self.message = arms, message

    def __reduce__(self) -> tuple[type[NoStartError], tuple[tuple[str, ...], str]]:
        return type(self), (self.arms, self.message)


class TooCloseError(InvalidInputError, UnreachableError):
    """A start at which bodies are inside their margins. The message names them, how near they are, and remedies."""


class UndecidedError(CoopqpError):
    """A computation failed numerically: its question stays open."""


class MissingCoreError(CoopqpError, ImportError):
    """The compiled core is not there, or cannot be loaded. The message says what to install."""

    def __init__(self, why: str) -> None:
        super().__init__(
            f"the compiled core of coopqp is missing: {why}. Where no wheel fits, it is built, by a C++ compiler: "
            "pip install --force-reinstall coopqp"
        )
        self.why = why

    def __reduce__(self) -> tuple[type[MissingCoreError], tuple[str]]:
        return type(self), (self.why,)


class RemovedNameError(CoopqpError, ImportError):
    """A name that an earlier version had. The message says what replaces it."""


def removed(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """``__getattr__`` of a module that had some names before, each with what replaces it.

    It raises a RemovedNameError for those, and an AttributeError for all others.
    """

    def look(name: str) -> Any:
        if name in names:
            raise RemovedNameError(f"{module}.{name} is gone: {names[name]}.")
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return look


class MissingExtraError(CoopqpError, ImportError):
    """An optional dependency is not installed. The message names the extra."""

    def __init__(self, extra: str, package: str) -> None:
        super().__init__(f"this needs the package '{package}': pip install 'coopqp[{extra}]'")
        self.extra, self.package = extra, package

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        return type(self), (self.extra, self.package)


class MissingSolverError(MissingExtraError):
    """A QP solver that coopqp knows and that is not installed; the message says what to install."""

    def __init__(self, solver: str, remedy: str) -> None:
        ImportError.__init__(self, f"the QP solver '{solver}' is not installed: {remedy}")
        self.extra, self.package, self.remedy = "solvers", solver, remedy

    def __reduce__(self) -> tuple[type[MissingSolverError], tuple[str, str]]:
        return type(self), (self.package, self.remedy)


#: Characters of a message: more are left out before its last ones, which have the remedy.
_LONGEST, _LAST = 4000, 500


def _bounded(message: str) -> str:
    return message if len(message) <= _LONGEST else f"{message[: _LONGEST - _LAST]} … {message[-_LAST:]}"


def cause_of(error: BaseException | None, kind: type[BaseException]) -> bool:
    """Whether an error is of a kind, or an error that it was raised from: errors of a file name the file."""
    while error is not None:
        if isinstance(error, kind):
            return True
        error = error.__cause__
    return False


def said(error: BaseException) -> str:
    """Type and message of an error that a user's code raised, for a message of at most 200 characters."""
    try:
        text = str(error)
    except Exception:  # its own __str__ may raise anything
        text = ""
    name = type(error).__name__
    return f"{name}: {text}"[:200] if text else name


#: Names that are compared for a suggestion, and characters of each: to compare long ones takes minutes.
_COMPARED, _CHARACTERS = 1000, 60
#: Names that a message lists.
_LISTED = 60


def nearest(name: str, known: Iterable[str], *, most: int = 1, cutoff: float = 0.6) -> list[str]:
    """The names most like another one, the nearest first. Of long names their beginnings are compared.

    Args:
        name: the name.
        known: names.
        most: number of names that are returned at most.
        cutoff: how alike they are at least, 0 to 1.
    """
    heads: dict[str, str] = {}
    for other in itertools.islice(known, _COMPARED):
        heads.setdefault(other[:_CHARACTERS], other)
    return [heads[head] for head in difflib.get_close_matches(name[:_CHARACTERS], heads, n=most, cutoff=cutoff)]


def listed(names: Sequence[str]) -> str:
    """Names for a message: the first ones, each of at most 60 characters, and how many more there are."""
    more = f", and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(map(shortened, names[:_LISTED])) + more


def shown(value: Any) -> str:
    """``repr`` of a value for a message, at most 60 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print integers with thousands of digits
        text = type(value).__name__
    return shortened(text)


def shortened(text: str) -> str:
    """At most 60 characters of a text; a quoted one keeps its quote at the end."""
    return text if len(text) <= 60 else f"{text[:57]}…{text[0] if text[0] in _QUOTES else ''}"


_QUOTES = "'\""


def has_controls(text: str) -> bool:
    """True if a text has characters that control a terminal or the order of writing, or that no file can hold."""
    return any(_is_control(c) for c in text)


def printable(text: str) -> str:
    r"""A text whose control characters are written as escapes, as ``\x1b``."""
    return "".join(c.encode("unicode_escape").decode() if _is_control(c) else c for c in text)


def _is_control(character: str) -> bool:
    return unicodedata.category(character) in _CONTROLS


#: Categories of Unicode: control, format (also the direction of writing), surrogates, line and paragraph separators.
_CONTROLS = ("Cc", "Cf", "Cs", "Zl", "Zp")


__getattr__ = removed(
    __name__,
    {"KernelWarning": "without the compiled core nothing runs, and its absence is a MissingCoreError"},
)
