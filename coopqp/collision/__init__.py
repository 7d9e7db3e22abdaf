"""Nothing touches: shapes of arms, object and surroundings, their distances, and the rows and bounds that keep them.

Import public names from here. The distances come from coal, which comes with Pinocchio.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
