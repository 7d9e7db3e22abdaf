"""A step of the core asks the heap for nothing, and Python for nothing, as its steps at 1 kHz must not.

A library that counts calls of malloc and its kin stands before the C library's in a process of its own. There the core
makes a few steps, then many more, with nothing of Python in between: both ask the heap equally often, which is for what
the call from Python needs.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from coopqp import QPController
from coopqp.scenarios import paper_lift

TRAP = r"""
#include <stddef.h>
extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);
static long asked;
long heap_calls(void) { return asked; }
void *malloc(size_t size) { return asked++, __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return asked++, __libc_calloc(count, size); }
void *realloc(void *at, size_t size) { return asked++, __libc_realloc(at, size); }
void *memalign(size_t to, size_t size) { return asked++, __libc_memalign(to, size); }
void *aligned_alloc(size_t to, size_t size) { return asked++, __libc_memalign(to, size); }
"""
#: Prints per case how often 300 and 2000 steps asked the heap, the least of three times, and how many steps were made.
STEPS = """
import ctypes, gc, sys
import numpy as np
from coopqp import QPController, QPOptions
from coopqp import scenarios
gc.disable()
heap_calls = ctypes.CDLL(sys.argv[1]).heap_calls
heap_calls.restype = ctypes.c_long

before = heap_calls()
large = np.zeros(1 << 20)
print("trap", 0, heap_calls() - before, 0)

def asked(controller, q, steps):
    before = heap_calls()
    done = controller._loop._core.advance(steps, q)
    return heap_calls() - before, done

CASES = {
    "nominal": ("paper_lift", {}, None), "seven": ("dual_arm7", {}, None), "slow": ("mixed_cell", {}, 2.0),
    "limit": ("at_limit", {}, 5.0), "qp": ("at_limit", {"shortcut": False}, None),
    "singular": ("at_singularity", {}, 5.0), "manipulability": ("dual_arm7", {"posture": {"manipulability": 1.0}}, 5.0),
    "shared": ("torso_lift", {}, None), "few": ("positioner", {}, None), "scara": ("scara_pair", {}, None),
    "blind": ("paper_lift", {"preview": None}, 5.0),
}
for name, (scenario, options, acceleration) in CASES.items():
    task = getattr(scenarios, scenario)()
    cell = task.cell if acceleration is None else task.cell.with_limits(acceleration=acceleration)
    for measured in (None, np.array(task.q_start)):
        controller = QPController(cell, task.grasp, task.path, dt=0.002, options=options)
        controller.reset(task.q_start)
        asked(controller, measured, 5)
        few, many = ([asked(controller, measured, steps) for _ in range(3)] for steps in (300, 2000))
        print(name, min(few)[0], min(many)[0], sum(done for _, done in few + many))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the trap stands before the C library of Linux")
@pytest.mark.skipif("LD_PRELOAD" in os.environ, reason="another library stands before the C library")
@pytest.mark.skipif(not shutil.which("cc"), reason="the trap has to be compiled")
def test_steps_of_the_core_ask_the_heap_for_nothing(tmp_path: Path) -> None:
    source, trap = tmp_path / "trap.c", tmp_path / "trap.so"
    source.write_text(TRAP)
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", trap, source], check=True)
    ran = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", STEPS, trap], env=os.environ | {"LD_PRELOAD": str(trap)},
        stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    (_, _, seen, _), *cases = (line.split() for line in ran.stdout.splitlines())
    assert int(seen) > 0  # the trap sees an array of a megabyte
    assert len(cases) == 22
    for name, few, many, steps in cases:
        assert (name, steps) == (name, "6900")
        assert (name, int(many) - int(few)) == (name, 0)


def test_a_step_asks_python_for_nothing() -> None:
    """But for the ControlStep that it returns, which C makes."""
    task, called = paper_lift(), list[str]()
    controller = QPController(task.cell, task.grasp, task.path, dt=0.002)
    controller.reset(task.q_start)
    q = controller.step().q_next
    step = controller.step
    sys.setprofile(lambda frame, event, _: called.append(f"{event} {frame.f_code.co_name}"))
    for _ in range(50):
        step(q)
    sys.setprofile(None)
    assert {one for one in called if one.startswith("call ")} <= {"call step"}
    assert called.count("call step") <= 50
