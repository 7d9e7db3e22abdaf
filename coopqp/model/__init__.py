"""The model: arms, cell, state, grasp, closed chain, inverse kinematics."""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
