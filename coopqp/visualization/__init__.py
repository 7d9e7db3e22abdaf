"""Visualisation: plots, timeline, renderer, viewer, report.

Import public names from here or from :mod:`coopqp`. The viewer needs ``coopqp[viewer]``.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
