"""Checks of arguments: numbers, vectors and counts. A bad value raises a named error."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, TypeAlias, TypeVar, get_type_hints

import numpy as np
import numpy.typing as npt

from coopqp.errors import InvalidInputError, UnknownNameError, shown

Array: TypeAlias = npt.NDArray[np.float64]
Flags: TypeAlias = npt.NDArray[np.bool_]
#: Arguments that become arrays: numbers in lists, tuples or arrays.
ArrayLike: TypeAlias = npt.ArrayLike

_Options = TypeVar("_Options")


@dataclass(frozen=True)
class Doc:
    """The meaning of an option and its unit, as in ``Annotated[float, Doc("… [m]")]``: for docstrings and cell files.

    Attributes:
        documentation: the text, plain, without a full stop.
    """

    documentation: str


def meanings(options: Callable[..., Any]) -> dict[str, str]:
    """The texts of all :class:`Doc` of a class or function, by the name of the attribute or argument."""
    hints = get_type_hints(options, include_extras=True)
    marks = {
        name: [mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Doc)]
        for name, hint in hints.items()
    }
    return {name: found[0].documentation for name, found in marks.items() if found}


class Refusing:
    """Options of which earlier versions had more: those are refused, by name.

    Attributes:
        removed: names that are no more, and what to do instead.
    """

    removed: ClassVar[Mapping[str, str]] = {}

    def __new__(cls, **given: Any) -> Any:
        """Refuse what is no more."""
        for name in given.keys() & cls.removed.keys():
            raise InvalidInputError(f"{name} is no longer an option", cls.__name__, cls.removed[name])
        return super().__new__(cls)


def documented(options: type[_Options]) -> type[_Options]:
    """Complete a class of options for ``help()`` and the reference: its docstring, and plain types of its arguments."""
    vars(options)["__init__"].__annotations__.update(get_type_hints(options))
    lines = [f"        {name}: {text}." for name, text in meanings(options).items()]
    options.__doc__ = "\n".join([(options.__doc__ or "").rstrip(), "", "    Attributes:", *lines, "    "])
    return options


#: Exceptions of NumPy and Python for values that are not numbers.
NOT_NUMBERS = (TypeError, ValueError, OverflowError)
#: Array kinds that NumPy converts to float with a loss of information: complex numbers, durations, dates.
_NO_FLOATS = "cmM"


def as_vector(value: Any, size: int, where: str) -> Array:
    """Return a new finite float vector of shape (size,).

    Raises:
        InvalidInputError: wrong shape, not numbers, NaN or infinite entries.
    """
    try:
        vector = as_floats(value)
    except NOT_NUMBERS as error:
        raise InvalidInputError(f"not a vector of numbers ({error})", where, f"Give {size} numbers.") from error
    if vector.shape != (size,):
        raise InvalidInputError(
            f"expected shape ({size},), got {vector.shape}", where, f"Give a flat vector of {size} numbers."
        )
    if not np.isfinite(vector).all():
        bad = np.flatnonzero(~np.isfinite(vector)).tolist()
        raise InvalidInputError(f"entries {bad} are NaN or infinite", where, "Give finite numbers.")
    return vector


def one_each(value: Any, size: int, where: str, *, finite: bool = True, remedy: str = "") -> Array:
    """Return a new float vector of shape (size,) from one number or from size numbers.

    Raises:
        InvalidInputError: another number of them, not numbers, NaN, or infinite entries unless not ``finite``.
    """
    remedy = remedy or ("Give one." if size == 1 else f"Give one or {size}.")
    try:
        given = as_floats(value)
        full = np.array(np.broadcast_to(given, (size,)))
    except NOT_NUMBERS as error:
        what = "is no number" if size == 1 else f"is neither a number nor {size} numbers"
        raise InvalidInputError(what, where, remedy) from error
    if finite:
        return as_vector(full, size, where)
    if np.isnan(full).any():
        bad = np.flatnonzero(np.isnan(full)).tolist()
        raise InvalidInputError("is NaN" if given.size == 1 else f"entries {bad} are NaN", where, remedy)
    return full


def as_scalar(value: Any, where: str, *, low: float = 0.0, high: float = np.inf, open_low: bool = True) -> float:
    """Return a finite float in (low, high] (or [low, high] with ``open_low=False``)."""
    number = _as_float(value, where)
    if not np.isfinite(number) or number > high or number < low or (open_low and number == low):
        begin, end = "(" if open_low else "[", "]" if np.isfinite(high) else ")"
        raise InvalidInputError(
            f"{number:g} is outside {begin}{low:g}, {high:g}{end}", where, "Give a number inside the interval."
        )
    return number


#: Steps of a controller are shorter than this [s]; others were meant in milliseconds.
_MILLISECONDS = 1.0


def as_step(value: Any, where: str) -> float:
    """Return the length of a controller's steps, a float in (0, 1) [s]."""
    number = as_scalar(value, where)
    if number >= _MILLISECONDS:
        raise InvalidInputError(
            f"steps of {number:g} s are too long (they are below {_MILLISECONDS:g} s), as if they were milliseconds",
            where,
            f"Give seconds: {1e-3 * number:g}.",
        )
    return number


def as_seed(value: Any, where: str) -> int:
    """Return a seed of random numbers, an integer ≥ 0."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
        raise InvalidInputError(f"seed is {shown(value)}", where, "Give a whole number from 0 on.")
    return int(value)


def as_count(value: Any, where: str) -> int:
    """Return an integer ≥ 1."""
    number = _as_float(value, where)
    if not (1.0 <= number < 2.0**53 and number == int(number)):
        raise InvalidInputError(f"{number:g} is no whole number of 1 or more", where, "Give 1, 2, 3, …")
    return int(number)


def keep_scalars(options: object, *names: str, low: float = 0.0, high: float = np.inf, open_low: bool = True) -> None:
    """Check fields of a frozen dataclass with :func:`as_scalar` and store the resulting floats in them."""
    for name in names:
        where = f"{type(options).__name__}: {name}"
        number = as_scalar(getattr(options, name), where, low=low, high=high, open_low=open_low)
        object.__setattr__(options, name, number)


def as_options(kind: type[_Options], value: Any, where: str) -> _Options:
    """Options from an object, a dictionary of its fields, or None for the defaults.

    Args:
        kind: a dataclass of options.
        value: the caller's argument.
        where: the argument, for messages.

    Raises:
        InvalidInputError: neither of them, or a bad value in a dictionary.
        UnknownNameError: a dictionary has a key that is no field.
    """
    if value is None:
        return kind()
    if isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        what = "the class itself" if value is kind else f"a {type(value).__name__}"
        raise InvalidInputError(what, where, f"Give {kind.__name__}(…), a dictionary of its fields, or nothing.")
    known = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    for name in value:
        if name not in known and name not in getattr(kind, "removed", ()):
            raise UnknownNameError("option", str(name), known, where)
    return kind(**value)


def require(value: Any, kind: type | tuple[type, ...], where: str, remedy: str) -> None:
    """Raise InvalidInputError unless ``value`` is an instance of ``kind``."""
    if not isinstance(value, kind):
        raise InvalidInputError(f"a {type(value).__name__}", where, remedy)


def as_tuple(value: Any, where: str, remedy: str) -> tuple[Any, ...]:
    """The entries of a list or another iterable.

    Raises:
        InvalidInputError: ``value`` is not iterable.
    """
    try:
        return tuple(value)
    except TypeError as error:
        raise InvalidInputError(f"a {type(value).__name__}", where, remedy) from error


def _as_float(value: Any, where: str) -> float:
    try:
        if isinstance(value, (bool, np.bool_, str, bytes)):  # float() would read them
            raise TypeError
        if isinstance(value, (np.ndarray, np.generic)) and (value.ndim or value.dtype.kind in _NO_FLOATS):
            raise TypeError
        return float(value)
    except NOT_NUMBERS as error:
        raise InvalidInputError(f"not a number ({shown(value)})", where, "Give a finite number.") from error


def as_floats(value: Any) -> Array:
    """Return a new float array of any shape.

    Raises:
        NOT_NUMBERS: the value does not consist of real numbers.
    """
    raw = np.asarray(value)
    if raw.dtype.kind in _NO_FLOATS:
        raise TypeError(f"numbers of type {raw.dtype} are not real")
    return np.array(raw, dtype=float)


def read_only(array: Array) -> Array:
    """Return a contiguous read-only copy."""
    copy = np.array(array, dtype=float, order="C")
    copy.flags.writeable = False
    return copy
