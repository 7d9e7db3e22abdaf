"""Runs: plants, the control loop, recordings, monitoring and assessment.

What users need is in :mod:`coopqp`. The names here replay a motion on the physics engine without a controller.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.simulation.plants.physics_options import Interpolation
    from coopqp.simulation.plants.replay import Motion, Replay, exact_motion, recorded_motion
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.simulation.plants.physics_options": ("Interpolation",),
            "coopqp.simulation.plants.replay": ("Motion", "Replay", "exact_motion", "recorded_motion"),
        },
    )

__all__ = ["Interpolation", "Motion", "Replay", "exact_motion", "recorded_motion"]
