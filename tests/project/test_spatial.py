"""Checks of arguments (placements, vectors, numbers) and the logarithm: a named error or a correct round trip."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from coopqp import InvalidInputError
from coopqp.checks import as_scalar, as_vector, read_only
from coopqp.spatial import ROTATION_TOLERANCE, adjoint, as_placement, as_placements, axis_angle, cross, skew, twist_at

Array = NDArray[np.float64]
MANY = settings(max_examples=10 * settings().max_examples)

coordinate = st.floats(-10.0, 10.0)
vectors = st.tuples(*[coordinate] * 3).map(np.array)
turns = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


@st.composite
def placements(draw: st.DrawFn) -> pin.SE3:
    return pin.SE3(pin.exp3(draw(turns)), draw(vectors))


#: Values of many kinds in place of numbers.
scalars_of_all_kinds = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.complex_numbers(),
    st.text(max_size=5),
    st.binary(max_size=5),
    st.sampled_from([1e300, -1e300, 5e-324, np.float32(1.5), np.int8(3), np.bool_(True), object(), {}, set()]),
)
arrays_of_all_kinds = st.one_of(
    hnp.arrays(
        dtype=st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex128, np.dtype("U3")]),
        shape=hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=6),
    ),
    hnp.arrays(np.float64, st.sampled_from([(3,), (6,), (4, 4)]), elements=st.floats(width=64)),
)
anything = st.one_of(scalars_of_all_kinds, arrays_of_all_kinds, st.lists(scalars_of_all_kinds, max_size=6))


# -- checks of arguments -------------------------------------------------------------------------------------------


def attempt(read: Callable[[Any], Any], value: Any) -> Any:
    """The result of ``read`` for a value, or None if it raises the right error."""
    try:
        return read(value)
    except InvalidInputError as error:
        refusal = error
    assert str(refusal).startswith("the spot: ")
    assert refusal.what
    assert refusal.remedy
    return None


@MANY
@given(anything)
@example([10**400, 0, 0])
@example(10**400)
@example(np.array([1j, 0.0, 0.0]))
@example(np.array(["1", "2", "3"]))
@example([1.0, [2.0], 3.0])
@example(np.array([1.0, np.nan, 2.0]))
@example(np.array([1.0]))
@example("nan")
@example(np.full((4, 4), 1e300))
@example(np.eye(4).tolist())
@example(np.eye(4, dtype=complex))
@example(np.eye(4, dtype=np.int32))
@example(np.eye(4)[:, ::-1])
@pytest.mark.slow
def test_a_value_is_refused_by_name_or_read_correctly(value: Any) -> None:
    vector = attempt(lambda x: as_vector(x, 3, "the spot"), value)
    if vector is not None:
        assert vector.shape == (3,)
        assert vector.dtype == np.float64
        assert np.isfinite(vector).all()
        assert np.array_equal(vector, [float(x) for x in np.asarray(value)])
        assert not (isinstance(value, np.ndarray) and np.shares_memory(vector, value))
    number = attempt(lambda x: as_scalar(x, "the spot", low=-1.0, high=2.0), value)
    if number is not None:
        assert type(number) is float
        assert -1.0 < number <= 2.0
        assert number == float(value)
    placement = attempt(lambda x: as_placement(x, "the spot"), value)
    if placement is not None:
        R = placement.rotation
        assert np.abs(R @ R.T - np.eye(3)).max() <= 1e-8
        np.testing.assert_allclose(
            placement.homogeneous, np.asarray(value, dtype=float), rtol=0, atol=ROTATION_TOLERANCE
        )


@given(placements())
def test_a_placement_is_copied_whatever_its_form(T: pin.SE3) -> None:
    matrix = T.homogeneous.copy()
    forms: list[Any] = [T, matrix, matrix.tolist(), np.asfortranarray(matrix), np.repeat(matrix, 2, axis=1)[:, ::2]]
    frozen = matrix.copy()
    frozen.flags.writeable = False
    for form in [*forms, frozen]:
        got = as_placement(form, "here")
        assert np.array_equal(got.homogeneous, matrix)
        got.translation[:] = 99.0
        got.rotation[:] = 0.0
        assert np.array_equal(T.homogeneous, matrix)
        assert np.array_equal(np.asarray(getattr(form, "homogeneous", form)), matrix)


@pytest.mark.parametrize("decimals", [4, 5, 6, 8, 17])
def test_a_printed_rotation_is_read_as_the_nearest_one(decimals: int, rng: np.random.Generator) -> None:
    """Also as an SE3. Good to the last digit that was printed; a rotation of full length is taken bit by bit."""
    for _ in range(200):
        T = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        printed = T.homogeneous.round(decimals)
        for form in (printed, pin.SE3(printed)):
            got = as_placement(form, "here")
            assert np.abs(got.rotation @ got.rotation.T - np.eye(3)).max() < 1e-8
            np.testing.assert_allclose(got.homogeneous, T.homogeneous, rtol=0, atol=1.5 * 10.0**-decimals + 1e-15)
            assert decimals < 17 or np.array_equal(got.homogeneous, printed)


def shear() -> Array:
    matrix = np.eye(4)
    matrix[0, 1] = 1e-3
    return matrix


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        (np.diag([2.0, 2.0, 2.0, 1.0]), "not a rotation"),
        (np.diag([-1.0, 1.0, 1.0, 1.0]), "not a rotation"),  # a reflection
        (shear(), "not a rotation"),
        (np.diag([1.0, 1.0, 1.001, 1.0]), "not a rotation"),
        (np.zeros((4, 4)), "last row"),
        (np.eye(4) + np.eye(4)[:, ::-1], "last row"),
        (np.array(pin.SE3(np.eye(3), np.ones(3)).homogeneous).T, "transposed"),
        (np.eye(3), "4x4"),
        (np.eye(4)[None], "4x4"),
        (np.full((4, 4), np.nan), "NaN"),
        (np.diag([np.inf, 1.0, 1.0, 1.0]), "NaN or infinite"),
        (pin.SE3(2.0 * np.eye(3), np.zeros(3)), "not a rotation"),
        (pin.SE3(np.eye(3), np.array([np.nan, 0.0, 0.0])), "NaN"),
        ("pose", "not a placement"),
        (None, "4x4"),
    ],
)
def test_what_is_no_placement(matrix: Any, says: str) -> None:
    with pytest.raises(InvalidInputError, match="base of arm 3") as caught:
        as_placement(matrix, "base of arm 3")
    assert says in str(caught.value)
    assert isinstance(caught.value, ValueError)
    assert caught.value.what
    assert caught.value.remedy


@given(placements(), st.floats(-1e-7, 1e-7))
def test_rounding_of_a_rotation_is_accepted(T: pin.SE3, defect: float) -> None:
    matrix = T.homogeneous.copy()
    matrix[0, 0] += defect
    as_placement(matrix, "here")


@pytest.mark.parametrize("value", [5, None, pin.SE3.Identity(), 1.5])
def test_one_placement_is_no_sequence(value: Any) -> None:
    with pytest.raises(InvalidInputError, match="grasps"):
        as_placements(value, "grasps")


def test_a_sequence_names_the_bad_entry() -> None:
    with pytest.raises(InvalidInputError, match=r"grasps\[1\]"):
        as_placements([np.eye(4), np.ones((4, 4))], "grasps")
    assert as_placements((), "grasps") == ()
    assert len(as_placements(np.array([np.eye(4)] * 3), "grasps")) == 3


@pytest.mark.parametrize(
    ("low", "high", "open_low", "inside", "outside"),
    [
        (0.0, np.inf, True, [1e-300, 1e300], [0.0, -1.0, np.inf, np.nan]),
        (0.0, np.inf, False, [0.0, -0.0, 1.0], [-1e-300, -np.inf]),
        (-1.0, 1.0, True, [1.0, -0.999], [-1.0, 1.0 + 1e-15, None, "x", [1.0], 1j]),
    ],
)
def test_intervals_of_numbers(low: float, high: float, open_low: bool, inside: list[Any], outside: list[Any]) -> None:
    for value in inside:
        assert as_scalar(value, "here", low=low, high=high, open_low=open_low) == value
    for value in outside:
        with pytest.raises(InvalidInputError, match="here"):
            as_scalar(value, "here", low=low, high=high, open_low=open_low)


@given(hnp.arrays(np.float64, (2, 3), elements=st.floats(-1, 1)))
def test_read_only_is_a_frozen_copy(array: Array) -> None:
    frozen = read_only(array[:, ::-1])
    assert np.array_equal(frozen, array[:, ::-1])
    assert not np.shares_memory(frozen, array)
    with pytest.raises(ValueError, match="read-only"):
        frozen[0, 0] = 1.0


# -- SE(3) -----------------------------------------------------------------------------------------------------------


@given(turns, turns, st.one_of(st.floats(0.0, np.pi), st.floats(1e-9, 0.1).map(lambda short: np.pi - short)))
def test_axis_and_angle_give_the_rotation_back_to_rounding(w: Array, axis: Array, angle: float) -> None:
    """At every angle, also near π; of a product, whose entries are rounded."""
    length = float(np.linalg.norm(axis))
    turn = pin.exp3(angle * axis / length) if length > 1e-3 else np.eye(3)
    R = pin.exp3(w).T @ (pin.exp3(w) @ turn)
    r, found = axis_angle(R)
    assert 0.0 <= found <= np.pi
    assert np.linalg.norm(r) == pytest.approx(1.0, abs=1e-14) or found == np.linalg.norm(r) == 0.0
    np.testing.assert_allclose(pin.exp3(found * r), R, rtol=0, atol=1e-14)


@given(placements(), placements())
def test_adjoint_is_a_homomorphism(T: pin.SE3, U: pin.SE3) -> None:
    np.testing.assert_allclose(adjoint(T * U), adjoint(T) @ adjoint(U), rtol=0, atol=1e-12)
    np.testing.assert_allclose(adjoint(T.inverse()) @ adjoint(T), np.eye(6), rtol=0, atol=1e-11)


@given(placements(), vectors, turns)
def test_adjoint_carries_a_motion(T: pin.SE3, v: Array, w: Array) -> None:
    xi = np.concatenate([v, w])
    left = T * pin.exp6(pin.Motion(xi)) * T.inverse()
    right = pin.exp6(pin.Motion(adjoint(T) @ xi))
    np.testing.assert_allclose(left.homogeneous, right.homogeneous, rtol=0, atol=1e-10)


@given(vectors, vectors)
def test_skew_and_cross_are_the_cross_product(a: Array, b: Array) -> None:
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), rtol=0, atol=1e-13)
    np.testing.assert_allclose(cross(a[None], b[None])[0], np.cross(a, b), rtol=0, atol=1e-13)
    assert np.array_equal(skew(a).T, -skew(a))


def random_axis(rng: np.random.Generator) -> Array:
    r = rng.normal(size=3)
    return np.asarray(r / np.linalg.norm(r))


def exp(xi: Array) -> tuple[Array, Array]:
    """Rotation and translation of a displacement, without the cancellation of (1 − cos θ)/θ²."""
    w = xi[3:]
    theta = np.linalg.norm(w)
    a, b = np.sinc(theta / np.pi), 0.5 * np.sinc(0.5 * theta / np.pi) ** 2
    x = theta * theta
    c = (theta - np.sin(theta)) / theta**3 if theta > 1.0 else 1 / 6 - x / 120 + x**2 / 5040 - x**3 / 362880
    if 0.3 < theta <= 1.0:
        c += x**4 / 39916800 - x**5 / 6227020800 + x**6 / 1307674368000
    W = skew(w)
    return np.eye(3) + a * W + b * W @ W, (np.eye(3) + b * W + c * W @ W) @ xi[:3]


def log_of_exp(xi: Array) -> Array:
    """Pinocchio's logarithm, which every step takes, of a displacement (6,)."""
    return np.asarray(pin.log6(pin.SE3(*exp(xi))).vector)


@given(st.floats(-14.0, np.log10(3.1)), st.floats(-6.0, 1.0), st.integers(0, 2**32 - 1))
def test_log_inverts_exp(log_angle: float, log_length: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, length = 10.0**log_angle, 10.0**log_length
    xi = np.concatenate([length * random_axis(rng), angle * random_axis(rng)])
    # Pinocchio's own rounding, and the conditioning of an axis near half a turn.
    tolerance = 1e-12 if angle < 0.02 else 1e-12 / (np.pi - angle) ** 2
    np.testing.assert_allclose(log_of_exp(xi), xi, rtol=0, atol=tolerance * max(1.0, length))


def test_half_a_turn_is_not_mistaken_for_none(rng: np.random.Generator) -> None:
    """Near half a turn the skew part of a rotation is as small as near the identity."""
    for angle in (np.pi, np.pi - 1e-9, np.pi - 1e-3):
        xi = np.concatenate([rng.normal(size=3), angle * random_axis(rng)])
        got = log_of_exp(xi)
        assert np.linalg.norm(got[3:]) == pytest.approx(angle, abs=1e-7)
        again = pin.exp6(pin.Motion(got)).homogeneous
        np.testing.assert_allclose(again, pin.exp6(pin.Motion(xi)).homogeneous, rtol=0, atol=1e-6)


def test_log_of_nan_is_nan() -> None:
    assert np.isnan(pin.log6(pin.SE3(np.full((3, 3), np.nan), np.zeros(3))).vector).any()


def test_twists_at_another_point_are_the_adjoints(rng: np.random.Generator) -> None:
    twists, way = rng.normal(size=(6, 4)), rng.normal(size=3)
    np.testing.assert_allclose(twist_at(twists, way), adjoint(pin.SE3(np.eye(3), -way)) @ twists, rtol=0, atol=1e-14)
