"""Shared parts of the fuzz tests: odd arrays, poses and numbers, and the accepted results for them."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from fractions import Fraction
from random import Random
from typing import Any

import numpy as np
import pinocchio as pin
from hypothesis import Phase, given, note, settings, strategies as st

from coopqp import CoopqpError, InvalidInputError

#: At least 2400 examples of each property in CI, more for a property of many functions.
MANY = settings(max_examples=12 * settings().max_examples)
MORE = settings(max_examples=14 * settings().max_examples)
#: Cases drawn from one seed. Hypothesis takes longer to draw an odd array than most functions to refuse it.
PER_SEED = 10


class Tried:
    """Number of examples that ran for a property, and number of accepted ones."""

    def __init__(self) -> None:
        self.number = self.accepted = 0

    def each(self, holds: Callable[[Random], None], wanted: settings = MANY) -> None:
        """Run a property as often as ``wanted`` says, on random numbers from seeds that Hypothesis chooses.

        A failure names the seed and the case; it is not made smaller: each case is one short sequence of draws.
        """
        phases = [phase for phase in settings().phases if phase is not Phase.shrink]

        @settings(max_examples=-(-wanted.max_examples // PER_SEED), phases=phases)
        @given(st.integers(0, 2**64 - 1))
        def cases(seed: int) -> None:
            rng = Random(seed)
            for case in range(PER_SEED):
                self.number += 1
                try:
                    holds(rng)
                except BaseException:
                    note(f"case {case} of seed {seed}")
                    raise

        cases()

    def row(self, catalogue: Any, test: str, wanted: settings = MANY) -> None:
        """Add a line to the catalogue. All examples passed; this checks that enough of them ran."""
        note = f"{self.accepted:,} accepted" if self.accepted else ""
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

ODD = [np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324, 2.2e-308, -0.0, 1e-12, 1e19]
#: Values that are no number, or a number of another type.
OTHERS = [
    *(None, True, "fast", "1.5", b"1", 1j, [], [1.0], [1.0, 2.0], {}, object(), 10**400, Fraction(1, 3)),
    *(np.float32(0.25), np.int64(2), np.array(0.5), np.array([0.5]), np.array(np.nan), np.complex128(1.0)),
]


def number_like(rng: Random) -> Any:
    """A value of any kind in place of a number."""
    draw: Callable[[], Any] = rng.choice(
        (
            lambda: struct.unpack("d", rng.randbytes(8))[0],
            lambda: rng.choice(ODD),
            lambda: rng.uniform(1e-6, 10.0),
            lambda: rng.randint(-3, 5),
            lambda: rng.choice(OTHERS),
        )
    )
    return draw()


def positive_like(rng: Random, *odd: float) -> float:
    """A positive number of any size, between 1e-3 and 1, or an odd one."""
    return rng.choice([rng.uniform(1e-3, 1.0), rng.choice([1e-300, 1e-12, 1e-6, 1e6, 1e12, 1e300, 1, 3, *odd])])


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


_HOW = [*CLOTHES, *CLOTHES, *LOSSY, *NONSENSE]
_WORN = {**CLOTHES, **LOSSY, **NONSENSE}
_FORM = ["right"] * 8 + sorted(FORMS)


def _uniform(rng: Random, shape: tuple[int, ...]) -> Any:
    """An array of numbers in (−3, 3)."""
    return np.array([rng.uniform(-3.0, 3.0) for _ in range(math.prod(shape))]).reshape(shape)


def array_like(rng: Random, usual: Any) -> tuple[Any, Any]:
    """An odd value in place of the array ``usual``, and the numbers in it (None if it has none).

    At most two entries are odd numbers. In half of the cases the others are unchanged, otherwise in (−3, 3).
    """
    a = np.array(usual, dtype=float)
    if rng.random() < 0.5:
        a = _uniform(rng, a.shape)
    for _ in range(rng.choice((0, 0, 1, 2))):
        a.flat[rng.randrange(a.size)] = rng.choice(ODD)
    form = rng.choice(_FORM)
    how = rng.choice(_HOW)
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


#: Forms of a placement T with the matrix M; all must be accepted.
RIGHT: dict[str, Callable[[pin.SE3, Any, Random], Any]] = {
    "SE3": lambda T, M, rng: T,
    "matrix": lambda T, M, rng: M,
    "list": lambda T, M, rng: M.tolist(),
    "strided": lambda T, M, rng: _strided(M),
    "fortran": lambda T, M, rng: np.asfortranarray(M),
    "read-only": lambda T, M, rng: _frozen(M),
    "rounded to 1e-8": lambda T, M, rng: np.where(np.arange(16).reshape(4, 4) < 12, M.round(8), M),
}
#: Values that are no placement.
WRONG: dict[str, Callable[[pin.SE3, Any, Random], Any]] = {
    "2 I": lambda T, M, rng: 2.0 * np.eye(4),
    "scaled": lambda T, M, rng: _scaled(M),
    "reflection": lambda T, M, rng: _reflected(M),
    "shear": lambda T, M, rng: _sheared(M),
    "off by 1e-3": lambda T, M, rng: _off(M),
    "raw SE3, scaled": lambda T, M, rng: pin.SE3(2.0 * T.rotation, T.translation),
    "raw SE3, NaN": lambda T, M, rng: pin.SE3(T.rotation, np.array([0.0, np.nan, 0.0])),
    "transposed": lambda T, M, rng: _with(M, 3, 1.0).T,
    "3 x 3": lambda T, M, rng: M[:3, :3],
    "3 x 4": lambda T, M, rng: M[:3],
    "stack": lambda T, M, rng: M[None],
    "flat": lambda T, M, rng: M.ravel(),
    "translation and quaternion": lambda T, M, rng: pin.SE3ToXYZQUAT(T),
    "zero": lambda T, M, rng: np.zeros((4, 4)),
    "huge": lambda T, M, rng: _with(M, 0, 1e300),
    "complex": lambda T, M, rng: M + 0j,
    "words": lambda T, M, rng: "here",
    "nothing": lambda T, M, rng: None,
    "number": lambda T, M, rng: 1.0,
    "last row": lambda T, M, rng: _with(M, 15, 1.0 + 1e-3),
    "bad entry": lambda T, M, rng: _with(M, rng.randrange(16), rng.choice((np.nan, np.inf, -np.inf))),
}
_RIGHT, _WRONG = list(RIGHT), list(WRONG)


def pose_like(rng: Random) -> tuple[Any, pin.SE3 | None]:
    """An odd value for a placement, and the placement in it (None if it is invalid)."""
    T = pin.SE3(pin.exp3(_uniform(rng, (3,))), _uniform(rng, (3,)))
    M = T.homogeneous.copy()
    if rng.random() < 0.5:
        return RIGHT[rng.choice(_RIGHT)](T, M, rng), T
    return WRONG[rng.choice(_WRONG)](T, M, rng), None
