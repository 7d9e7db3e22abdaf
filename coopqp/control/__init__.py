"""One step: limits, forms, ranks, supervision, and the controllers.

What users need is in :mod:`coopqp`. The names here are parts of a step, for measurements of it.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
