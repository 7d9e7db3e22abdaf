"""One step: velocity bounds, QP, priorities, look-ahead, monitoring, and the controllers.

What users need is in :mod:`coopqp`. The names here are parts of a step, for measurements of it. docs/derivations.md has
a table of the modules and of their counterparts in C++.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
