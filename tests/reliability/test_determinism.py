"""The same task gives the same commands: elsewhere in memory, in another process, with the arms in another order."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import reordered, with_mismatch
from processes import output

from coopqp import Clearance, CollisionScene, CommonError, QPController, QPOptions
from coopqp.collision import Body, Box
from coopqp.scenarios import Scenario, at_limit, dual_arm7, fast_lift, mixed_cell, ring, scara_pair

PROGRAM = Path(__file__).with_name("programs") / "repeat.py"


def ran(solver: str, steps: int, file: Path, seed: int) -> tuple[int, str]:
    """Number of steps and hash from a separate process with another hash seed of strings."""
    number, digest = output(PROGRAM, solver, steps, file, timeout=600, PYTHONHASHSEED=str(seed)).split()
    return int(number), digest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "steps", "target"), [("auto", 50_000, 0.0), ("daqp", 50_000, 0.0), ("proxqp", 10_000, 1e-10)]
)
def test_another_process_commands_the_same(
    solver: str, steps: int, target: float, count: Callable[[int], int], catalogue: Any, tmp_path: Path
) -> None:
    runs = [ran(solver, count(steps), tmp_path / f"{seed}.npy", seed) for seed in (1, 2)]
    assert runs[0][0] == runs[1][0] == count(steps)
    a, b = (np.load(tmp_path / f"{seed}.npy") for seed in (1, 2))
    assert len(a) > steps // 100  # many steps solved a QP
    if target == 0.0:
        catalogue.row(
            "E",
            f"two processes, one hash over all commands, {solver}",
            cases=runs[0][0],
            measured=runs[0][1] != runs[1][1],
            target=0,
            unit="differences",
            note=f"{len(a):,} of the steps solved a QP",
        )
    else:
        catalogue.row(
            "E",
            f"two processes, joint velocities of the steps with a QP, {solver}",
            cases=len(a),
            measured=float(np.abs(a - b).max()) if a.shape == b.shape else np.inf,
            target=target,
            unit="rad/s",
            note=f"of {runs[0][0]:,} steps; hashes {'agree' if runs[0][1] == runs[1][1] else 'differ'}",
        )


# -- the order of the arms ---------------------------------------------------------------------------------------------


def commands(task: Scenario, names: Sequence[str], options: QPOptions, steps: int) -> Any:
    """Joint velocities (steps, nv), with the arms in the order of ``names``."""
    controller = QPController(task.cell, task.grasp, task.path, dt=0.005, options=options)
    controller.reset(task.q_start)
    columns = np.concatenate([np.arange(task.cell.nv)[task.cell.v_slices[task.cell.index(n)]] for n in names])
    return np.array([controller.step().velocity[columns] for _ in range(steps)])


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.slow
@pytest.mark.parametrize("how", ["as it comes", pytest.param("a QP at every step", marks=pytest.mark.slow)])
def test_the_order_of_the_arms_does_not_matter(
    how: str, rng: np.random.Generator, count: Callable[[int], int], catalogue: Any
) -> None:
    worst, where, cases = 0.0, "", 0
    for make in (fast_lift, at_limit, mixed_cell, dual_arm7, scara_pair, lambda: ring(arms=5)):
        task = with_mismatch(make(), 1, (0.0, 0.001, 0.0))  # which the controller corrects
        names = task.cell.arm_names
        orders = list(itertools.permutations(range(len(names))))[1:]
        for common in (CommonError.leader(names[0]), CommonError.leaderless()):
            options = QPOptions(common_error=common, shortcut=how == "as it comes")
            first = commands(task, names, options, 150)
            for i in rng.permutation(len(orders))[: count(5)]:
                apart = float(np.abs(commands(reordered(task, orders[i]), names, options, 150) - first).max())
                cases += len(first)
                if apart > worst:
                    worst, where = apart, task.name
    catalogue.row(
        "E",
        f"arms in another order, {how}",
        cases=cases,
        measured=worst,
        target=1e-11,
        unit="rad/s",
        note=f"six cells of two to five arms in closed loop, each by its leader and leaderless; largest in {where}",
    )


def beside_a_cart(steps: int) -> bytes:
    """Commands of two seven-joint arms that a cart pushes away: rows bind, and redundant joints have a choice."""
    task, dt, v = ring(arms=2, robot="arm7"), 0.004, np.array([0.28, -0.095, 0.039])
    cell = task.cell.with_limits(acceleration=15.0)
    first = task.path.pose(0.0).translation + np.array([-0.844, 0.319, -0.026])
    cart = Body("cart", Box((0.263, 0.263, 0.263)), pin.SE3(np.eye(3), first))
    scene = CollisionScene.of(task, cell=cell, margin=0.02, moving=[cart])
    clearance = Clearance(scene, give_way=True)
    controller = QPController(cell, task.grasp, task.path, dt=dt, constraints=[clearance])
    controller.reset(task.q_start)
    commands = []
    for i in range(steps):
        clearance.move("cart", pin.SE3(np.eye(3), first + i * dt * v), (*v, 0.0, 0.0, 0.0))
        commands.append(controller.step().q_next)
    return np.array(commands).tobytes()


@pytest.mark.core
def test_bits_do_not_depend_on_where_memory_lies() -> None:
    rng = np.random.default_rng(0)
    first = beside_a_cart(400)
    for _ in range(8):
        others = [np.empty(n) for n in rng.integers(1, 400, 200)]  # the next run's memory lies elsewhere
        assert beside_a_cart(400) == first
        del others


@pytest.mark.core
@pytest.mark.parametrize("make", [mixed_cell, dual_arm7])
def test_a_restart_repeats_to_the_last_bit(make: Callable[[], Scenario]) -> None:
    task = make()
    cell = task.cell.with_limits(acceleration=4.0)
    controller = QPController(cell, task.grasp, task.path, dt=0.005)

    def ran(steps: int) -> bytes:
        controller.reset(task.q_start)
        made = [controller.step() for _ in range(steps)]
        return np.array([[*step.q_next, step.clock_next, step.rate] for step in made]).tobytes()

    first = ran(40)
    for steps in (1, 9):
        ran(steps)  # it starts again from close by
        assert ran(40) == first
