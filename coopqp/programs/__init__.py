"""Programs: phases in which arms hold, let go, travel, work on the part, or open it."""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
