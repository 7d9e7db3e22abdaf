"""Runs: plants, the control loop, recordings, monitoring and assessment.

What users need is in :mod:`coopqp`. The names here run scenarios in the physics engine, and replay a motion there
without a controller.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
