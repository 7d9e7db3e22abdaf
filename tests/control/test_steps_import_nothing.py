"""What a step needs is loaded before it: in a new process no call of an operator makes a step import a module."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import sys, warnings
import numpy as np
import pinocchio as pin
from coopqp import Clearance, CollisionScene, ForceController, LinePath, ObjectPath, QPController, ServoPath
from coopqp.scenarios import dual_arm7, plate_and_post, regrasp_plate

class Own(ObjectPath):
    def __init__(self, path):
        self._path, self.duration = path, path.duration
    def pose(self, clock):
        return self._path.pose(clock)
    def twist(self, clock):
        return self._path.twist(clock)

shift = pin.SE3(np.eye(3), np.array([0.005, 0.0, 0.0]))
calls = [
    lambda c: c.set_override(0.5), lambda c: c.shift_path(shift, over=0.02), lambda c: c.reverse(0.1),
    lambda c: c.forward(), lambda c: c.run_to(0.3), lambda c: c.step_to_mark(), lambda c: c.pause(),
    lambda c: c.resume(), lambda c: c.gear(0.1), lambda c: c.jog([0.05, 0.0, 0.0, 0.0, 0.0, 0.1], deadman_s=0.2),
    lambda c: c.return_to_path(), lambda c: c.engage(shift), lambda c: c.target(shift * shift), lambda c: c.release(),
    lambda c: c.return_to_path(), lambda c: c.follow(c.path, clock=getattr(c, "program_clock", 0.0)),
    lambda c: c.retarget(shift), lambda c: c.signal("closed"),
]

def run(task, path, *, bodies=False, forces=False):
    cell = task.cell.with_limits(acceleration=5.0)
    scene = [Clearance(CollisionScene.of(task, cell=cell, margin=0.02))] if bodies else []
    c = QPController(cell, task.grasp, path, dt=0.004, constraints=scene)
    c = ForceController(c, {"stiffness": 1e5}) if forces else c
    c.reset(task.q_start)
    loaded = set(sys.modules)
    for call in calls:
        for _ in range(30):
            c.step()
        try:
            call(c)
        except ValueError:  # not on this path
            pass
        except KeyError:
            pass
    far = (c.controller if forces else c).commanded
    c.step(far + 0.2), c.step(np.full(cell.nq, np.nan)), c.step("x"), c.step(dt=9.0)
    new = set(sys.modules) - loaded
    print(type(path).__name__, *sorted(new))

task = dual_arm7()
run(task, task.path)
run(task, Own(task.path))
run(task, ServoPath(task.path.pose(0.0)))
run(task, task.path, forces=True)
task = plate_and_post()
run(task, task.path, bodies=True)
task = regrasp_plate()
run(task, task.path)
"""


@pytest.mark.slow
def test_no_step_imports_a_module() -> None:
    found = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SCRIPT], capture_output=True, text=True, timeout=120, check=False
    )
    assert found.returncode == 0, found.stderr
    lines = found.stdout.splitlines()
    assert len(lines) == 6
    assert not [line for line in lines if len(line.split()) > 1], lines
