"""The load along a motion: derivatives at uneven samples, and what is said of it in figures and in a sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import BindingLimit, Grasp, InvalidInputError, LimitKind, RobotCell
from coopqp.forces import (
    LoadShare,
    LoadUse,
    SharedLoad,
    load_use,
)
from coopqp.planning import Payload
from coopqp.scenarios import Scenario


def test_a_quadratic_motion_at_uneven_times_has_its_own_velocities_and_accelerations(
    make_cell: Callable[..., RobotCell], rng: np.random.Generator
) -> None:
    """Between the first and the last sample exactly; at these two the mean velocity, and the acceleration beside."""
    cell = make_cell(["arm7"])
    payload = Payload(mass=5.0, centre=[0.1, 0.0, 0.05], inertia=0.1 * np.eye(3))
    load = LoadShare(cell, Grasp((pin.SE3.Identity(),)), payload, internal_force=1e3)
    time = np.array([0.0, 0.1, 0.15, 0.4, 0.5])
    q0, v, a = np.array([0.1, 0.5, -0.2, -1.2, 0.3, 0.8, 0.2]), rng.uniform(-1, 1, 7), rng.uniform(-2, 2, 7)
    rows = q0 + np.outer(time, v) + 0.5 * np.outer(time**2, a)
    velocities = v + np.outer(time, a)
    velocities[0], velocities[-1] = (rows[1] - rows[0]) / 0.1, (rows[-1] - rows[-2]) / 0.1
    use = load_use(load, time, np.array([cell.configuration(x) for x in rows]))
    for i, (x, dx) in enumerate(zip(rows, velocities, strict=True)):
        q = cell.configuration(x)
        twist, acceleration = load.object_motion(q, dx, a)
        shared = load.share(q, twist=twist, acceleration=acceleration, joint_velocity=dx, joint_acceleration=a)
        np.testing.assert_allclose(use.torques[i], shared.torques, atol=1e-8)
        np.testing.assert_allclose(use.wrenches[i], shared.wrenches, atol=1e-8)
        np.testing.assert_allclose(use.joint[i], shared.joint_use, atol=1e-8)
        assert use.share[i] == shared.share
    np.testing.assert_array_equal(use.time, time)
    for wrong in (
        (time[::-1], rows), (time[:2], rows[:2]), (time, rows[:, :6]), (time[:, None], rows), (time, rows[:4]),
        ([0.0, 0.1, 0.1, 0.4, 0.5], rows),
    ):  # fmt: skip
        with pytest.raises(InvalidInputError, match="three samples or more, with times that increase"):
            load_use(load, *wrong)
    with pytest.raises(InvalidInputError, match="no numbers"):
        load_use(load, "now", rows)
    assert load_use(load, time[:3], rows[:3]).feasible


def test_the_figures_name_the_most_used_limits_and_the_first_sample_that_is_too_heavy(paper: Scenario) -> None:
    T, nv, n = 4, 18, 3
    joint, grip, internal = np.full((T, nv), 0.1), np.full((T, n), 0.2), np.full((T, n), 0.3)
    joint[2, 7], grip[1, 2], internal[3, 1] = 0.9876, 0.5, 0.777
    joint[3, 5] = 0.9876 + 1e-9  # rounding: the first one counts
    binds = BindingLimit("slave_1", "", LimitKind.TORQUE), BindingLimit("master", "", LimitKind.GRIP_FORCE)
    share = np.array([1.0, 1.0, 0.75, 0.8])
    use = LoadUse(
        paper.cell, np.array([0.0, 0.25, 0.5, 1.0]), joint, grip, internal, share, np.zeros((T, nv)),
        np.zeros((T, n, 6)), ((), (), binds, ()),
    )  # fmt: skip
    assert use.figures() == {
        "load carried": "75.0 %",
        "torque, most used": f"98.8 % ({paper.cell.joint_names[7]}, 0.50 s)",
        "grip, most used": "50.0 % (slave_2, 0.25 s)",
        "internal force, most used": "77.7 % (slave_1, 1.00 s)",
        "too heavy from": f"0.50 s on ({binds[0]}, {binds[1]})",
    }
    assert not use.feasible


def shared_load(share: float, binding: tuple[BindingLimit, ...], **use: Any) -> SharedLoad:
    none = {"joint_use": np.array([0.2, 0.3]), "grip_use": np.array([0.1]), "internal_use": np.array([0.05]), **use}
    wrenches, torques = np.zeros((1, 6)), np.zeros(2)
    return SharedLoad(wrenches, wrenches, torques, torques, share, binding=binding, **none)


def test_a_share_of_a_load_is_explained_in_a_sentence() -> None:
    """With four limits at most."""
    limits = [BindingLimit(f"a{i}", "", LimitKind.TORQUE) for i in range(5)]
    assert shared_load(1.0, ()).explain() == "The arms carry the load with 30.0 % of their limits."
    assert "with 40.0 %" in shared_load(1.0, (), grip_use=np.array([0.4])).explain()
    assert "with 50.0 %" in shared_load(1.0, (), internal_use=np.array([0.5])).explain()
    four = ", ".join(map(str, limits[:4]))
    assert (
        shared_load(1.0, tuple(limits[:4])).explain()
        == f"The arms carry the load with 30.0 % of their limits ({four})."
    )
    assert shared_load(0.5, tuple(limits)).explain() == f"The arms carry 50.0 % of the load ({four}, …)."
    assert shared_load(1.0, ()).feasible
    assert not shared_load(1.0 - 1e-9, ()).feasible
