"""The cooperative controller: settings, the loop over the core that makes its steps, and what an operator asks of it.

What users need is in :mod:`coopqp`. docs/derivations.md derives the step, and says in which file of the core it stands.
"""

from coopqp.lazy import attach, moved

_STEP = "the core makes every step; docs/examples/the_step.py is a step in NumPy, to be read"
__getattr__, __dir__, __all__ = attach(
    __name__,
    __file__,
    gone={
        **dict.fromkeys(("LinearisedStep", "Pieces", "PlainLoop", "Proposal", "StepTerms"), _STEP),
        "PathPreview": "the core looks ahead; PreviewOptions has its settings",
    },
)
moved(f"{__name__}.step.formulations", f"{__name__}.options")  # RankWeights, in pickles of version 0.2
