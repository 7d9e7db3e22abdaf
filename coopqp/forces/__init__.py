"""Forces between the arms and the object: load sharing, internal stress, calibration from gripped runs.

What most users need is in :mod:`coopqp`. The names here share a load, and plan the motion for a calibration.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
