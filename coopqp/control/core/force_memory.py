"""The memory of the relaxation of forces by name; the core works on it, see ``force_relaxation.h``."""

from __future__ import annotations

import math
from typing import Any

from coopqp.core import _core
from coopqp.core._core import RELAXING, SENSORS_FINE
from coopqp.spatial import Array

#: Arms that relax hold where they squeeze by this multiple of the force at the start.
_MORE_THAN_AT_START = 1.1


def relaxation_scalars(memory: Array) -> Any:
    """The scalars of the memory, by name."""
    return _core.ForceRelaxation.of(memory)


def relaxation_views(memory: Array, arms: int) -> dict[str, Array]:
    """The parts of the memory behind its scalars, by name; :mod:`coopqp.forces.frictional_contacts` has ``palms``."""
    n, views, at = 6 * arms, {}, _core.ForceRelaxation.NUMBERS
    shapes: tuple[tuple[str, tuple[int, ...]], ...] = (
        ("silent", (arms,)), ("seen", (arms, 6)), ("internal", (arms, 6)), ("shift", (arms, 6)), ("drift", (arms, 6)),
        ("target", (arms, 6)), ("squeezed", (arms, 6)),
        ("internal_of", (n, n)), ("yields", (n, n)), ("palms", (arms, 2, 4, 6)),
        ("felt", (arms, 6)), ("held", (arms, 6)), ("off_servos", (arms, 6)), ("off_last", (arms, 6)),
        ("off_step", (arms, 6)), ("off_drift", (arms, 6)), ("off_noise", (arms,)),
        ("holding", (arms,)), ("freed", (arms,)), ("compliances", (arms, 6, arms, 6)), ("carries", (n, 3)),
        ("unfed_of", (n, n)), ("reference", (12,)), ("centre", (3,)), ("travel", (3, 3)), ("push", (5, 3)),
    )  # fmt: skip
    for name, shape in shapes:
        size = math.prod(shape)
        views[name] = memory[at : at + size].reshape(shape)
        at += size
    return views


def relaxation_size(arms: int) -> int:
    """Size of the memory for a number of arms."""
    size: int = _core.ForceRelaxation.size_for(arms)
    return size


def gives_way(m: Any) -> bool:
    """The grasps give way in this step, unless a sensor is silent for too long."""
    return bool(m.stepped and m.stage >= RELAXING and m.sensor_fault == SENSORS_FINE)


def squeezes(m: Any) -> bool:
    """The arms squeeze the object while they relax, more than at the start: what should relax them pulls."""
    if m.stage != RELAXING or m.has_palms:
        return False
    return bool(m.largest_force >= m.force_holds and m.largest_force > _MORE_THAN_AT_START * m.start_size)
