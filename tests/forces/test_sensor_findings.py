"""What is said of wrist sensors: each limit on both sides, in words; biases, drifts and stiffness in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Grasp
from coopqp.forces import SensorFinding, SensorJudgement
from coopqp.forces.sensor_findings import judge
from coopqp.scenarios import paper_lift, ring
from coopqp.spatial import Array

LIFT, PAIR = paper_lift(), ring(arms=2)
NAMES = LIFT.cell.arm_names
TOLERANCE, LATEST = 10.0, 0.028
#: Load on the object that the drives carry [N, N·m].
WEIGHT = np.array([0.0, 120.0, 160.0, 4.0, -3.0, 2.0])
RATIO = 1.4
UP = (0.0, 1.0, 0.0)
TURNED = "its axes are turned by 90° about (-0.6, 0, 0.8) of the tool"
LATE = "its wrenches come 41 ms after their causes, above 28 ms: give delay"


def about(way: Sequence[float], degrees: float) -> Array:
    return np.asarray(pin.exp3(np.deg2rad(degrees) * np.array(way, dtype=float)))


def carried(grasp: Grasp, load: Array) -> Array:
    """The least wrenches at the tools (N, 6) that carry a load, torques at a tenth of a metre."""
    maps = np.hstack([X.actionInverse.T for X in grasp.T_object_tool])
    metric = np.tile([1.0] * 3 + [100.0] * 3, len(grasp))
    return np.asarray((maps.T @ np.linalg.solve((maps / metric) @ maps.T, load) / metric).reshape(-1, 6))


class Told:
    """Sensors of arms that hold a load and press each other, as the fit tells them; all right, if nothing is changed.

    Args:
        reads: the arm of each sensor.
        gains, rotations: of each sensor, by its index; others are 1.
        bias, drift: the same, beside what it should read.
        load: the load that the arms carry really.
        more: other results of the fit.
    """

    def __init__(
        self, *, grasp: Grasp = LIFT.grasp, reads: Sequence[int] | None = None, gains: Any = None,
        rotations: Any = None, bias: Any = None, drift: Any = None, ratio: float = RATIO, load: Array = WEIGHT,
        **more: Any,
    ) -> None:  # fmt: skip
        rng, n = np.random.default_rng(1), len(grasp)
        self.grasp, self.servos = grasp, rng.uniform(-9.0, 9.0, (n, 6))
        self.slopes, stiffer = rng.uniform(-0.5, 0.5, (n, 6)), np.array([1.1, 0.8, 1.2])[:n]
        self.at_rest, paces = (ratio * stiffer[:, None] * y for y in (self.servos, self.slopes))
        self.arms = np.arange(n) if reads is None else np.array(reads)
        self.carried = carried(grasp, load)[self.arms]
        self.held = self.at_rest[self.arms] + self.carried
        self.gains = np.array([(gains or {}).get(k, (1.0, 1.0)) for k in range(n)], dtype=float)
        self.rotations = np.array([(rotations or {}).get(k, np.eye(3)) for k in range(n)])
        self.maps = np.zeros((n, 6, 6))
        self.maps[:, :3, :3], self.maps[:, 3:, 3:] = (self.gains[:, i, None, None] * self.rotations for i in range(2))
        read, grows = (np.einsum("kij,kj->ki", self.maps, y) for y in (self.held, paces[self.arms]))
        for k, value in (bias or {}).items():
            read[k] += value
        for k, value in (drift or {}).items():
            grows[k] += value
        self.fit: Any = SimpleNamespace(
            arms=self.arms, rotations=self.rotations, gains=ratio * self.gains, stiffer=stiffer, offsets=read,
            slopes=grows, **{"delays": np.full(n, 0.01), "misfit": np.zeros(n), "noise": np.full((n, 2), 0.5),
            "lost": np.zeros(n), "doubts": np.zeros(n), **more},
        )  # fmt: skip

    def judged(self, *, weight: Array | None = WEIGHT, unbalanced: float = 1.0) -> SensorJudgement:
        names = tuple(NAMES[: len(self.grasp)])
        return judge(
            self.fit, self.grasp, names, servos=self.servos, servo_slopes=self.slopes, weight=weight,
            unbalanced=unbalanced, tolerance=TOLERANCE, latest=LATEST,
        )  # fmt: skip


def one(**told: Any) -> SensorFinding:
    """What is said of the second sensor; nothing is said of the others."""
    judgement = Told(**told).judged()
    assert judgement.findings[0].fine
    assert judgement.findings[2].fine
    return judgement.findings[1]


@pytest.mark.parametrize("weight", [WEIGHT, None])
@pytest.mark.parametrize("unbalanced", [0.0, 0.14, 1.0])
def test_right_sensors_are_right(weight: Array | None, unbalanced: float) -> None:
    """Whether the load is known or not, and whether they agree with each other or not; the stiffness comes back."""
    told = Told()
    judgement = told.judged(weight=weight, unbalanced=unbalanced)
    assert judgement.fine
    assert judgement.explain() == "all sensors are right"
    assert judgement.latest == 0.0
    assert judgement.stiffer == pytest.approx(RATIO)
    np.testing.assert_array_equal(judgement.arms_stiffer, told.fit.stiffer)
    for name, f in zip(NAMES, judgement.findings, strict=True):
        assert (f.arm, f.sits_at, f.problems, f.dead, f.late, f.undecided) == (name, name, (), False, False, False)
        assert (f.force_gain, f.torque_gain) == pytest.approx((1.0, 1.0))
        assert (f.delay, f.noise, f.lost) == (0.01, 0.5, 0.0)
        np.testing.assert_allclose([f.bias, f.drift], 0.0, atol=1e-9)
        assert f.explain() == f"the sensor of arm {name}: right"


@pytest.mark.parametrize(
    ("told", "problems"),
    [
        ({"gains": {1: (0.66, 1.0)}}, []),
        ({"gains": {1: (0.64, 1.0)}}, ["its forces are 0.64 times the real ones"]),
        ({"gains": {1: (1.34, 1.0)}}, []),
        ({"gains": {1: (1.36, 1.0)}}, ["its forces are 1.4 times the real ones"]),
        ({"gains": {1: (1.0, 0.66)}}, []),
        ({"gains": {1: (1.0, 0.21)}}, ["its torques are 0.21 times the real ones"]),
        ({"gains": {1: (1.0, 0.19)}}, ["its torques are dead"]),
        ({"gains": {1: (0.0, 1.0)}}, ["its forces are dead"]),
        ({"gains": {1: (0.1, -0.1)}}, ["it is dead"]),
        ({"gains": {1: (1.0, 590.0)}}, ["its torques are 5.9e+02 times the real ones"]),
        ({"gains": {1: (1.0, 610.0)}}, ["its torques come in N·mm"]),
        ({"gains": {1: (1.0, 1590.0)}}, ["its torques come in N·mm"]),
        ({"gains": {1: (1.0, 1610.0)}}, ["its torques are 1.6e+03 times the real ones"]),
        ({"gains": {1: (-1.0, 1.0)}}, ["its forces have the wrong sign"]),
        ({"gains": {1: (1.0, -1.0)}}, ["its torques have the wrong sign"]),
        ({"gains": {1: (-1.0, -1.0)}}, ["its forces and torques have the wrong sign"]),
        ({"gains": {1: (-1.0, -0.1)}}, ["its torques are dead", "its forces have the wrong sign"]),
        ({"gains": {1: (-2.0, 1.0)}}, ["its forces have the wrong sign", "its forces are 2 times the real ones"]),
        ({"rotations": {1: about(UP, 19.5)}}, []),
        ({"rotations": {1: about(UP, 20.6)}}, ["its axes are turned by 21° about (0, 1, 0) of the tool"]),
        ({"rotations": {1: about((-0.6, 0, 0.8), 90)}}, [TURNED]),
        ({"lost": np.array([0.44, 0.44, 0.44])}, []),
        ({"lost": np.array([0.0, 0.46, 0.0])}, ["46 % of its samples are lost"]),
        ({"misfit": np.array([0.0, 0.34, 0.0])}, []),
        ({"misfit": np.array([0.0, 0.36, 0.0])}, ["undecided: no arm, axes and gain explain what it reads"]),
        ({"delays": np.array([0.01, 0.0275, 0.01])}, []),
        ({"delays": np.array([0.01, 0.041, 0.01])}, [LATE]),
        ({"drift": {1: [1.2, 0.0, 1.5, 0.0, 9.0, 0.0]}}, []),
        ({"drift": {1: [1.2, 0.0, -1.7, 0.0, 0.0, 0.0]}}, ["it drifts by 2.1 N/s"]),
        ({"bias": {1: [0.0, 0.0, 0.0, 40.0, 0.0, 0.0]}}, []),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_nothing_else(told: dict[str, Any], problems: list[str]) -> None:
    found = one(**told)
    assert list(found.problems) == problems
    assert found.fine == (not problems)
    assert found.undecided == any("undecided" in text for text in problems)
    assert found.late == any("come 41 ms" in text for text in problems)
    assert found.dead == any("dead" in text for text in problems)
    assert found.explain() == f"the sensor of arm slave_1: {', '.join(problems) or 'right'}"


def test_swapped_sensors_are_said_by_the_arms_that_they_read() -> None:
    judgement = Told(reads=[0, 2, 1]).judged(unbalanced=0.0)
    assert [f.sits_at for f in judgement.findings] == [NAMES[0], NAMES[2], NAMES[1]]
    assert [f.problems for f in judgement.findings] == [
        (), ("it reads the wrenches of arm slave_2",), ("it reads the wrenches of arm slave_1",),
    ]  # fmt: skip
    assert not judgement.fine
    assert judgement.explain() == "; ".join(f.explain() for f in judgement.findings[1:])
    np.testing.assert_allclose([f.bias for f in judgement.findings], 0.0, atol=1e-9)
    np.testing.assert_allclose([f.drift for f in judgement.findings], 0.0, atol=1e-9)


def test_a_late_sensor_is_late_only_if_nothing_else_is_wrong() -> None:
    """And the largest delay of such sensors is told, not that of a sensor that is wrong."""
    delays: dict[str, Any] = {"delays": np.array([0.03, 0.05, 0.06])}
    right, lost = Told(**delays).judged(), Told(lost=np.array([0.0, 0.0, 0.5]), **delays).judged()
    assert [f.late for f in right.findings] == [True] * 3
    assert right.latest == 0.06
    assert [f.late for f in lost.findings] == [True, True, False]
    assert lost.latest == 0.05
    assert not Told(gains={2: (-1.0, 1.0)}, **delays).judged().findings[2].late
    silent = Told(gains={2: (0.0, 0.0)}, **delays).judged().findings[2]
    assert silent.problems == ("it is dead",)
    undecided = Told(misfit=np.array([0.0, 0.0, 0.9]), **delays).judged().findings[2]
    assert undecided.problems == ("undecided: no arm, axes and gain explain what it reads",)


@pytest.mark.parametrize("agree", [False, True])
def test_a_bias_counts_beyond_what_is_in_doubt(agree: bool) -> None:
    """The tolerance; 5 % of what servos press at rest and the median misfit; with sensors that agree with each other,
    how far torques and forces differ, and how far this sensor differs from the others, in what it carries."""
    misfit, gains = np.array([0.01, 0.04, 0.09]), {1: (1.1, 1.0)} if agree else {}
    plain = Told(misfit=misfit, gains=gains)
    at_rest, held = (float(np.linalg.norm(w[1, :3])) for w in (plain.at_rest, plain.carried))
    most = TOLERANCE + (0.05 + np.sqrt(0.04)) * at_rest + (0.1 * held if agree else 0.0)
    known = plain.judged(unbalanced=0.14 if agree else 0.16).findings[1]
    own = known.bias
    assert known.fine
    way = np.array([0.6, 0.0, -0.8, 0.0, 0.0, 0.0])
    for size, fine in ((0.99, True), (1.01, False)):
        told = Told(misfit=misfit, gains=gains, bias={1: size * most * way - own})
        found = told.judged(unbalanced=0.14 if agree else 0.16).findings[1]
        assert found.fine == fine
        np.testing.assert_allclose(found.bias[:3], size * most * way[:3], atol=1e-6)
    assert found.problems == (f"it reads {1.01 * most:.0f} N too much at rest (tolerance {most:.0f} N)",)


def test_sensors_that_agree_share_their_doubt_about_torques() -> None:
    """All torques 10 % off: a sensor may be off by 10 % of what servos press, more than otherwise."""
    gains = dict.fromkeys(range(3), (1.0, 1.1))
    told = Told(gains=gains)
    most = TOLERANCE + (0.05 + 1.0 - 1.0 / 1.1) * float(np.linalg.norm(told.at_rest[0, :3]))
    judged = [
        Told(gains=gains, bias={0: [0.0, 0.0, size * most, 0.0, 0.0, 0.0]}).judged(unbalanced=0.0).findings[0].fine
        for size in (0.99, 1.01)
    ]
    assert judged == [True, False]


def test_sensors_that_agree_have_one_gain() -> None:
    """Where what they read cancels within the object, gains of forces can be none of their own: their middle counts."""
    told = Told(gains={0: (1.2, 1.2), 1: (1.1, 0.88)})
    apart, agreed = (told.judged(weight=None, unbalanced=u).findings for u in (0.15, 0.1499))
    np.testing.assert_allclose([(f.force_gain, f.torque_gain) for f in apart], told.gains / 1.1)
    np.testing.assert_allclose([f.force_gain for f in agreed], 1.0)
    np.testing.assert_allclose([f.torque_gain for f in agreed], [1.0, 0.8, 1.0])
    wrong = Told(gains={0: (-1.2, 1.2), 1: (1.1, 0.88)}).judged(weight=None, unbalanced=0.0).findings
    assert wrong[0].force_gain == pytest.approx(-1.2 / 1.1)


@pytest.mark.parametrize(
    ("degrees", "doubt", "as_meant"),
    [(4.9, 0.0, True), (5.1, 0.0, False), (5.9, 2.0, True), (6.1, 2.0, False), (14.9, 9.0, True), (15.1, 9.0, False)],
)
def test_axes_that_may_be_as_told_are(degrees: float, doubt: float, as_meant: bool) -> None:
    """Up to 5°, or three deviations, but for 15°: what they read at rest is then compared without the turn."""
    told = Told(rotations={1: about(UP, degrees)}, doubts=np.deg2rad([0.0, doubt, 0.0]))
    found = told.judged().findings[1]
    expected = (told.maps[1] - np.eye(6)) @ told.held[1] if as_meant else np.zeros(6)
    np.testing.assert_allclose(found.bias, expected, atol=1e-9)
    np.testing.assert_allclose(found.rotation, about(UP, degrees))


@pytest.mark.parametrize(
    ("gain", "doubt", "as_meant"),
    [(1.07, 0.0, True), (0.93, 0.0, True), (1.09, 0.0, False), (1.11, 0.04, True), (1.13, 0.04, False)],
)
def test_gains_that_may_be_as_told_are(gain: float, doubt: float, as_meant: bool) -> None:
    """Within 8 %, or three deviations of the axes."""
    told = Told(gains={1: (gain, 1.0)}, doubts=np.array([0.0, doubt, 0.0]))
    found = told.judged().findings[1]
    expected = np.r_[(gain - 1.0) * told.held[1, :3], 0.0, 0.0, 0.0] if as_meant else np.zeros(6)
    np.testing.assert_allclose(found.bias, expected, atol=1e-9)
    assert found.force_gain == pytest.approx(gain)


def test_a_bias_is_what_is_read_beside_the_wrench_in_the_sensor_s_own_axes() -> None:
    told: dict[str, Any] = {"rotations": {1: about(UP, 90.0)}, "gains": {1: (-2.0, 3.0)}, "reads": [0, 2, 1]}
    bias, drift = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    found = Told(**told, bias={1: bias}, drift={1: drift}).judged().findings[1]
    np.testing.assert_allclose([found.bias, found.drift], [bias, drift], atol=1e-9)


def test_a_load_that_is_not_known_is_what_all_sensors_say() -> None:
    """A bias then counts as load, but for what the arms share otherwise."""
    bias = np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = Told(bias={1: bias}).judged(weight=None).findings
    wrong = np.zeros((3, 6))
    wrong[1] = bias
    total = sum(X.actionInverse.T @ w for X, w in zip(LIFT.grasp.T_object_tool, wrong, strict=True))
    np.testing.assert_allclose([f.bias for f in found], wrong - carried(LIFT.grasp, total), atol=1e-9)


# -- how stiff the servos are --------------------------------------------------------------------------------------


def ratio_of(*gains: float, weight: Array | None = None, load: Array = WEIGHT, ratio: float = RATIO) -> float:
    """ρ of sensors with such gains."""
    grasp = LIFT.grasp if len(gains) == 3 else PAIR.grasp
    told = Told(grasp=grasp, gains={k: (g, g) for k, g in enumerate(gains)}, load=load, ratio=ratio)
    return told.judged(weight=weight).stiffer / ratio


def test_without_a_load_most_sensors_tell_the_stiffness() -> None:
    assert ratio_of(1.0, 2.0, -1.5) == pytest.approx(1.5)
    assert ratio_of(1.0, 2.0, 0.19, ratio=1.0) == pytest.approx(1.5), "less than a fifth of what is told is dead"
    assert ratio_of(1.0, 2.0, 0.21, ratio=1.0) == pytest.approx(1.0)
    assert ratio_of(1.0, 1.2, 1000.0) == pytest.approx(1.2), "one that is far too loud makes no other dead"
    assert ratio_of(0.0, 0.0, 0.0) * RATIO == pytest.approx(1.0)


def test_of_two_sensors_the_one_is_right_by_which_servos_are_as_told() -> None:
    assert ratio_of(1.0, 3.0, ratio=1.0) == pytest.approx(1.0)
    assert ratio_of(3.0, 0.8, ratio=1.0) == pytest.approx(0.8)
    assert ratio_of(0.7, 1.6, ratio=1.0) == pytest.approx(0.7), "by their ratio to one"


def test_a_load_that_is_known_tells_the_stiffness_where_sensors_do_not_agree_with_it() -> None:
    """All gains alike say nothing of their own: 30 % off the load, they are believed; one of them is weighed, too."""
    assert ratio_of(1.5, 1.5, 1.5, weight=WEIGHT) == pytest.approx(1.0)
    assert ratio_of(1.4, 1.4, 1.4, weight=WEIGHT) == pytest.approx(1.4)
    assert ratio_of(0.78, 0.78, 0.78, weight=WEIGHT) == pytest.approx(0.78)
    assert ratio_of(0.76, 0.76, 0.76, weight=WEIGHT) == pytest.approx(1.0)
    assert ratio_of(1.2, 1.2, weight=WEIGHT) == pytest.approx(1.0), "two sensors are no majority"
    assert ratio_of(3.0, 3.0, 0.1, weight=WEIGHT) == pytest.approx(3.0), "one is dead: the load is not heard"
    assert ratio_of(3.0, 3.0, 3.0, weight=-WEIGHT) == pytest.approx(3.0), "what hangs upwards is no load"


@pytest.mark.parametrize(("size", "found"), [(19.9, 3.0), (20.1, 1.0)])
def test_a_load_of_20_newtons_weighs(size: float, found: float) -> None:
    load = np.array([0.0, 0.6 * size, 0.8 * size, 0.0, 0.0, 0.0])
    assert ratio_of(3.0, 3.0, 3.0, weight=load, load=load) == pytest.approx(found)
