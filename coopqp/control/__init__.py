"""One step: limits, forms, ranks, supervision, and the controllers.

What users need is in :mod:`coopqp`. The names here are parts of a step, for measurements of it.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.control.forms import Pieces, StepTerms
    from coopqp.control.limits import VelocityBox
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.control.forms": ("Pieces", "StepTerms"),
            "coopqp.control.limits": ("VelocityBox",),
        },
    )

__all__ = ["Pieces", "StepTerms", "VelocityBox"]
