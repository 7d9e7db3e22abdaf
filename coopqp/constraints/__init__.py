"""Further constraints, before the motion and in it: rows on joint velocities, bounds of the path speed, causes."""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
