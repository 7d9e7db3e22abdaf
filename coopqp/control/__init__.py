"""One step: limits, forms, ranks, supervision, and the controllers.

What users need is in :mod:`coopqp`. The names here are parts of a step, for measurements of it.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.control.lookahead.preview import PathPreview
    from coopqp.control.solvers.base import Outcome, Workspace
    from coopqp.control.step.constraint_set import Constraints
    from coopqp.control.step.formulations import Pieces, StepProgram, StepTerms
    from coopqp.control.step.linearised import LinearisedStep
    from coopqp.control.step.plain import PlainLoop
    from coopqp.control.step.priorities import StepSolver
    from coopqp.control.step.state import Proposal
    from coopqp.control.step.velocity_bounds import VelocityBox
    from coopqp.model.chain import Chain
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.control.step.constraint_set": "Constraints",
            "coopqp.control.step.formulations": "Pieces StepProgram StepTerms",
            "coopqp.control.step.velocity_bounds": "VelocityBox",
            "coopqp.control.step.linearised": "LinearisedStep",
            "coopqp.control.step.state": "Proposal",
            "coopqp.control.step.plain": "PlainLoop",
            "coopqp.control.step.priorities": "StepSolver",
            "coopqp.control.solvers.base": "Outcome Workspace",
            "coopqp.model.chain": "Chain",
            "coopqp.control.lookahead.preview": "PathPreview",
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
