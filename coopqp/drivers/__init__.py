"""Real robots: a control loop that sends every arm its commands at the rate of the slowest one, and drivers.

It is no safety function: the robots' own safety controllers stay in charge.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
