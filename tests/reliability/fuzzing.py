"""Shared parts of the fuzz tests: odd arrays, poses and numbers, and the accepted results for them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pinocchio as pin
from hypothesis import settings
from hypothesis import strategies as st

from coopqp import CoopqpError, InvalidInputError

#: At least 2000 examples of each property in CI, more for a property of many functions.
MANY = settings(max_examples=10 * settings().max_examples)
MORE = settings(max_examples=12 * settings().max_examples)


class Tried:
    """Number of examples that ran for a property, and number of accepted ones."""

    def __init__(self) -> None:
        self.number = self.accepted = 0

    def row(self, catalogue: Any, test: str, wanted: settings = MANY) -> None:
        """Add a line to the catalogue. All examples passed; this checks that enough of them ran."""
        note = f"{self.accepted:,} accepted and right, the others refused by a named error" if self.accepted else ""
        assert self.number >= 0.95 * wanted.max_examples, self.number  # Hypothesis draws a few examples twice
        catalogue.row("C", test, cases=self.number, measured=0, target=0, unit="failures", note=note)


def answer(build: Callable[[], Any]) -> Any:
    """The result of ``build``, or None after a named error with a remedy; other exceptions propagate."""
    try:
        return build()
    except CoopqpError as error:
        refusal = error
    if isinstance(refusal, InvalidInputError):
        assert refusal.what
        assert refusal.where
        assert refusal.remedy
    assert len(str(refusal)) > 15, refusal
    return None


def is_refused(build: Callable[[], Any]) -> bool:
    return answer(lambda: (build(),)) is None


def contents(value: Any) -> Any:
    """What a value says, to compare it later: bit for bit where it is an array of numbers."""
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return value.dtype, value.shape, value.tobytes()
    return str(value)


# -- numbers -----------------------------------------------------------------------------------------------------------

ordinary = st.floats(-3.0, 3.0)
odd = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324, 2.2e-308, -0.0, 1e-12, 1e19])
#: Values of many kinds in place of a number.
numbers = st.one_of(
    st.floats(),
    odd,
    st.floats(1e-6, 10.0),
    st.integers(-3, 5),
    st.sampled_from(
        [
            *(None, True, "fast", "1.5", b"1", 1j, [], [1.0], [1.0, 2.0], {}, object(), 10**400, Fraction(1, 3)),
            *(np.float32(0.25), np.int64(2), np.array(0.5), np.array([0.5]), np.array(np.nan), np.complex128(1.0)),
        ]
    ),
)


# -- arrays ------------------------------------------------------------------------------------------------------------


def _strided(a: Any) -> Any:
    if a.ndim == 0:
        return a
    wide = np.full(tuple(2 * n for n in a.shape), np.nan)
    view = wide[tuple(slice(None, None, 2) for _ in a.shape)]
    view[...] = a
    return view


def _frozen(a: Any) -> Any:
    a.flags.writeable = False
    return a


#: Other types with the same numbers; all must be accepted.
CLOTHES: dict[str, Callable[[Any], Any]] = {
    "as it is": lambda a: a,
    "list": lambda a: a.tolist(),
    "tuple": lambda a: tuple(a.tolist()) if a.ndim else float(a),
    "strided": _strided,
    "fortran": np.asfortranarray,
    "read-only": _frozen,
    "reversed view": lambda a: a[..., ::-1].copy()[..., ::-1] if a.ndim else a,
    "object": lambda a: a.astype(object),
    "float128": lambda a: a.astype(np.longdouble),
    "buffer": lambda a: memoryview(np.ascontiguousarray(a)) if a.ndim else a,
}
#: Types that change the numbers; the changed numbers must be used.
LOSSY: dict[str, Callable[[Any], Any]] = {
    "float32": lambda a: a.astype(np.float32),
    "float16": lambda a: a.astype(np.float16),
    "int": lambda a: np.nan_to_num(a, posinf=5.0, neginf=-5.0).clip(-1e9, 1e9).astype(np.int64),
    "bool": lambda a: a > 0.0,
    "text": lambda a: a.astype(str),
}
#: Values that are not arrays of numbers.
NONSENSE: dict[str, Callable[[Any], Any]] = {
    "complex": lambda a: a + 1j,
    "complex list": lambda a: (a + 1j).tolist(),
    "words": lambda a: np.full(a.shape, "abc"),
    "none": lambda a: None,
    "dates": lambda a: np.full(a.shape, np.datetime64("2020-01-01")),
    "ragged": lambda a: [a.tolist(), [1.0]],
    "huge integers": lambda a: [10**400] * max(a.size, 1),
    "mapping": lambda a: {0: a},
    "generator": lambda a: (x for x in a.ravel()),
    "objects": lambda a: np.full(a.shape, Ellipsis),
    "string": lambda a: "1 2 3",
}


#: Forms of an array, most often the right one.
FORMS: dict[str, Callable[[Any], Any]] = {
    "right": lambda a: a,
    "longer": lambda a: np.concatenate([a, a[:1]]),
    "shorter": lambda a: a[:-1],
    "column": lambda a: a[..., None],
    "row": lambda a: a[None],
    "scalar": lambda a: np.array(a.flat[0]),
    "empty": lambda a: np.zeros(0),
    "twice": lambda a: np.concatenate([a, a], axis=-1),
}


#: What an example draws from, made once: to make them takes longer than to draw.
_HOW = st.sampled_from([*CLOTHES, *CLOTHES, *LOSSY, *NONSENSE])
_WORN = {**CLOTHES, **LOSSY, **NONSENSE}
_FORM = st.sampled_from(["right"] * 8 + sorted(FORMS))
_COIN, _SEED = st.booleans(), st.integers(0, 2**32 - 1)
_THREE = st.lists(ordinary, min_size=3, max_size=3)


@functools.cache
def _places(size: int) -> st.SearchStrategy[list[int]]:
    """At most two entries of an array."""
    return st.lists(st.integers(0, size - 1), max_size=2)


@st.composite
def arrays_like(draw: st.DrawFn, usual: Any) -> tuple[Any, Any]:
    """An odd value in place of the array ``usual``, and the numbers in it (None if it has none).

    At most two entries are odd numbers. In half of the examples the others are unchanged, otherwise in (−3, 3).
    """
    a = np.array(usual, dtype=float)
    if draw(_COIN):
        a = np.random.default_rng(draw(_SEED)).uniform(-3.0, 3.0, a.shape)
    for i in draw(_places(a.size)):
        a.flat[i] = draw(odd)
    form = draw(_FORM)
    how = draw(_HOW)
    with np.errstate(over="ignore"):
        worn = _WORN[how](FORMS[form](a))
        meant = np.array(worn if how in LOSSY else a, dtype=float)
    return worn, meant if form == "right" and how not in NONSENSE else None


# -- poses -------------------------------------------------------------------------------------------------------------


def _sheared(M: Any) -> Any:
    M[0, 1] += 0.1
    return M


def _off(M: Any) -> Any:
    M[0, 0] += 1e-3
    return M


def _reflected(M: Any) -> Any:
    M[:3, 0] *= -1.0
    return M


def _scaled(M: Any) -> Any:
    M[:3, :3] *= 2.0
    return M


def _with(M: Any, i: int, value: float) -> Any:
    M.flat[i] = value
    return M


@st.composite
def poses_like(draw: st.DrawFn) -> tuple[Any, pin.SE3 | None]:
    """An odd value for a placement, and the placement in it (None if it is invalid)."""
    turn = np.array(draw(_THREE))
    shift = np.array(draw(_THREE))
    T = pin.SE3(pin.exp3(turn), shift)
    M = T.homogeneous.copy()
    right: dict[str, Callable[[], Any]] = {
        "SE3": lambda: T,
        "matrix": lambda: M,
        "list": M.tolist,
        "strided": lambda: _strided(M),
        "fortran": lambda: np.asfortranarray(M),
        "read-only": lambda: _frozen(M),
        "rounded to 1e-8": lambda: np.where(np.arange(16).reshape(4, 4) < 12, M.round(8), M),
    }
    wrong: dict[str, Callable[[], Any]] = {
        "2 I": lambda: 2.0 * np.eye(4),
        "scaled": lambda: _scaled(M),
        "reflection": lambda: _reflected(M),
        "shear": lambda: _sheared(M),
        "off by 1e-3": lambda: _off(M),
        "raw SE3, scaled": lambda: pin.SE3(2.0 * T.rotation, shift),
        "raw SE3, NaN": lambda: pin.SE3(T.rotation, np.array([0.0, np.nan, 0.0])),
        "transposed": lambda: _with(M, 3, 1.0).T,
        "3 x 3": lambda: M[:3, :3],
        "3 x 4": lambda: M[:3],
        "stack": lambda: M[None],
        "flat": lambda: M.ravel(),
        "translation and quaternion": lambda: pin.SE3ToXYZQUAT(T),
        "zero": lambda: np.zeros((4, 4)),
        "huge": lambda: _with(M, 0, 1e300),
        "complex": lambda: M + 0j,
        "words": lambda: "here",
        "nothing": lambda: None,
        "number": lambda: 1.0,
        "bad entry": lambda: _with(M, draw(st.integers(0, 15)), draw(st.sampled_from([np.nan, np.inf, -np.inf]))),
        "last row": lambda: _with(M, 15, 1.0 + 1e-3),
    }
    good = draw(_COIN)
    how = draw(st.sampled_from(sorted(right if good else wrong)))
    return (right[how](), T) if good else (wrong[how](), None)
