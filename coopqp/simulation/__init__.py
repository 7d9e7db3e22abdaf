"""Runs: plants, the control loop, recordings, monitoring and assessment.

What users need is in :mod:`coopqp`. The names here run scenarios in the physics engine, and replay a motion there
without a controller.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.simulation.engine import engine_controller, engine_plant, run_in_engine
    from coopqp.simulation.evaluation.wrenches import RunLoads, read_loads
    from coopqp.simulation.plants.physics_options import Interpolation
    from coopqp.simulation.plants.replay import Motion, Replay, exact_motion, recorded_motion
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.simulation.engine": "engine_controller engine_plant run_in_engine",
            "coopqp.simulation.evaluation.wrenches": "RunLoads read_loads",
            "coopqp.simulation.plants.physics_options": "Interpolation",
            "coopqp.simulation.plants.replay": "Motion Replay exact_motion recorded_motion",
        },
    )

__all__ = [
    "Interpolation",
    "Motion",
    "Replay",
    "RunLoads",
    "engine_controller",
    "engine_plant",
    "exact_motion",
    "read_loads",
    "recorded_motion",
    "run_in_engine",
]
