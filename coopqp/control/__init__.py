"""The cooperative controller: settings, the loop over the core that makes its steps, and what an operator asks of it.

What users need is in :mod:`coopqp`. docs/derivations.md derives the step, and says in which file of the core it stands.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
