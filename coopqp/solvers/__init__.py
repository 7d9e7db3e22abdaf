"""QP solvers behind one interface. Every problem is checked before, and every answer after the solve.

``ldp`` is the compiled core's own, for strictly convex QPs. ``proxqp`` and ``osqp`` are kept: memory, factorisation and
warm start survive from one solve to the next. Any other backend that qpsolvers finds installed works by its name, built
anew at every solve; ``qpsolvers:proxqp`` forces that route for a backend that could be kept.
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__, __file__, gone={"Workspace": "QpProblem.stacked has the constraints as one set of rows"}
)
