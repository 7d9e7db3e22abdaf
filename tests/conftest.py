"""Shared fixtures: Hypothesis profiles, cells that take time to build, and seeded random data.

Profiles: ``ci`` (default, always the same examples), ``check`` (a tenth of the examples), ``nightly`` (ten times as
many examples, new ones every time) and ``mutation`` (as ``ci``, but a failure is not made smaller: that takes long).
The variable HYPOTHESIS_PROFILE or ``pytest --hypothesis-profile`` selects the profile. A module that needs more
examples multiplies the profile's number, so the nightly run grows by the same factor.
"""

from __future__ import annotations

import functools
import gc
import os
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, Phase, settings
from runs import of_the_paper

from coopqp import Arm, Recording, RobotCell, simulate
from coopqp.scenarios import ROBOTS, Scenario, paper_lift, robot_path

#: tests/reliability/catalogue.py, whose table ends every run, and what compares runs with recorded ones.
pytest_plugins = ["catalogue", "recorded_before"]

settings.register_profile(
    "ci",
    max_examples=200,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.register_profile(
    "nightly", parent=settings.get_profile("ci"), max_examples=2000, derandomize=False, print_blob=True
)
settings.register_profile("check", parent=settings.get_profile("ci"), max_examples=20)
settings.register_profile("mutation", parent=settings.get_profile("ci"), phases=[Phase.explicit, Phase.generate])
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where several processes share the tests, those marked slow come first: no long one is left over at the end."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_collection_finish() -> None:
    """What was collected stays to the end: the garbage collector need not look at it again and again."""
    gc.collect()
    gc.freeze()


def _too_many_skips(config: pytest.Config) -> Counter[str]:
    """Why tests were skipped, if more were than COOPQP_MOST_SKIPS allows; without it any number may be."""
    most, reporter = os.environ.get("COOPQP_MOST_SKIPS"), config.pluginmanager.get_plugin("terminalreporter")
    skipped = reporter.stats.get("skipped", []) if reporter else []
    if most is None or len(skipped) <= int(most):
        return Counter()
    return Counter(str(report.longrepr[2] if report.longrepr else "no reason") for report in skipped)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Tests that are skipped prove nothing: too many of them are a failure."""
    if _too_many_skips(session.config) and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """The reasons of too many skips."""
    if reasons := _too_many_skips(config):
        most = os.environ["COOPQP_MOST_SKIPS"]
        terminalreporter.section(f"{reasons.total()} tests were skipped, {most} may be (COOPQP_MOST_SKIPS)", red=True)
        for reason, times in reasons.most_common():
            terminalreporter.write_line(f"{times:5} {reason}")


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers with a seed for each test: the same in every run, and in any package's folder."""
    file, _, test = request.node.nodeid.partition("::")
    folder, _, name = file.rpartition("/")
    kept = folder if folder == "tests/reliability" else "tests"
    return np.random.default_rng(zlib.crc32(f"{kept}/{name}::{test}".encode()))


@pytest.fixture(scope="session")
def paper() -> Scenario:
    """The paper's lift, with the linear time law."""
    return paper_lift()


@pytest.fixture(scope="session")
def lift() -> Scenario:
    """The paper's lift, from rest to rest."""
    return paper_lift(time_law="quintic")


@functools.cache
def _robot(robot: str) -> Arm:
    return Arm.from_urdf(robot, robot_path(robot), tool_frame=ROBOTS[robot].tool_frame, geometry=False)


@pytest.fixture(scope="session")
def make_cell() -> Callable[..., RobotCell]:
    """``make_cell(["rx90l", "arm7"], bases=…)``: arms ``0_rx90l``, ``1_arm7`` of robots that come with coopqp."""

    def make(robots: Sequence[str], bases: Sequence[pin.SE3] | None = None, **limits: Any) -> RobotCell:
        placed = bases or [pin.SE3(np.eye(3), np.array([0.0, 1.1 * k, 0.0])) for k in range(len(robots))]
        arms = [_robot(r).placed(T, name=f"{k}_{r}") for k, (r, T) in enumerate(zip(robots, placed, strict=True))]
        if all(np.ndim(limit) == 0 for limit in limits.values()):  # of the arms: another cell takes longer
            return RobotCell(replace(arm, limits=arm.limits.replace(**limits)) for arm in arms)
        return RobotCell(arms).with_limits(**limits)

    return make


@pytest.fixture(scope="session")
def mixed_cell(make_cell: Callable[..., RobotCell]) -> RobotCell:
    """4, 5, 6 and 7 joints, revolute, prismatic and continuous, on turned bases."""
    pin.seed(7)
    robots = ("arm7", "rx90l", "scara4", "gantry7", "arm5", "arm6c")
    return make_cell(robots, [pin.SE3.Random() for _ in robots])


@pytest.fixture(scope="session")
def random_q() -> Callable[[RobotCell, np.random.Generator], Any]:
    """``random_q(cell, rng)``: a configuration inside the limits (any angle without limits)."""

    def draw(cell: RobotCell, rng: np.random.Generator) -> Any:
        low = np.where(np.isfinite(cell.limits.lower), cell.limits.lower, -np.pi)
        high = np.where(np.isfinite(cell.limits.upper), cell.limits.upper, np.pi)
        return cell.configuration(rng.uniform(low, high))

    return draw


@pytest.fixture(scope="session")
def baseline(paper: Scenario) -> Callable[..., Recording]:
    """``baseline(N, **options)``: the paper's algorithm on the paper's lift in N steps, run once for all tests."""

    @functools.cache
    def run(steps: int, **options: Any) -> Recording:
        return simulate(of_the_paper(paper, steps, **options), q_start=paper.q_start)

    return run
