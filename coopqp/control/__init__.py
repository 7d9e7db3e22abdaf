"""One step: limits, forms, ranks, supervision, and the controllers.

What users need is in :mod:`coopqp`. The names here are parts of a step, for measurements of it.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.control.constraint_set import Constraints
    from coopqp.control.forms import Pieces, StepProgram, StepTerms
    from coopqp.control.limits import VelocityBox
    from coopqp.control.linearised import LinearisedStep
    from coopqp.control.loop_state import Proposal
    from coopqp.control.plain import PlainLoop
    from coopqp.control.ranks import StepSolver
    from coopqp.control.solvers.base import Outcome, Workspace
    from coopqp.model.chain import Chain
    from coopqp.planning.preview import PathPreview
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.control.constraint_set": "Constraints",
            "coopqp.control.forms": "Pieces StepProgram StepTerms",
            "coopqp.control.limits": "VelocityBox",
            "coopqp.control.linearised": "LinearisedStep",
            "coopqp.control.loop_state": "Proposal",
            "coopqp.control.plain": "PlainLoop",
            "coopqp.control.ranks": "StepSolver",
            "coopqp.control.solvers.base": "Outcome Workspace",
            "coopqp.model.chain": "Chain",
            "coopqp.planning.preview": "PathPreview",
        },
    )

__all__ = [
    "Chain",
    "Constraints",
    "LinearisedStep",
    "Outcome",
    "PathPreview",
    "Pieces",
    "PlainLoop",
    "Proposal",
    "StepProgram",
    "StepSolver",
    "StepTerms",
    "VelocityBox",
    "Workspace",
]
