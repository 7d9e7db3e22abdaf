"""The task: object paths, the common error, the posture of redundant arms."""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
