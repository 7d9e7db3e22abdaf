"""Before the motion: starts, the check of a path and its remedies, timing and plans."""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    __file__,
    gone=dict.fromkeys(("Bodies", "SearchedBodies"), "coopqp.CollisionScene has what they asked for"),
)
