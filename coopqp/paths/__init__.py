"""Paths of the object: its pose and twist over the path parameter, their geometry, and ready scenarios."""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
