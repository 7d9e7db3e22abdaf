"""What is certified runs to its end: programs on which tools move are led as other paths are."""

from __future__ import annotations

import pytest
from promise_cases.certified import certified, run

from coopqp.programs import Program


@pytest.mark.parametrize(("kind", "seed"), [("programs, seven joints", 1186), ("programs, seven joints", 1880)])
def test_a_certified_program_is_led_to_its_end(kind: str, seed: int) -> None:
    task = certified(kind, seed)
    assert task is not None
    assert isinstance(task.path, Program)
    assert task.led is not None
    assert task.led.elbows is not None
    assert run(task)[0]
