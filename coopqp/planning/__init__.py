"""Ahead of the clock and before the motion: the path preview, starts, the check of a path, and its timing.

Import names for users from here.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
