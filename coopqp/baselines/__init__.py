"""Controllers to compare with: the paper's pseudo-inverse, and one QP for each arm alone."""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
