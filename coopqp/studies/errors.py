"""Errors of studies."""

from __future__ import annotations

from coopqp.errors import CoopqpError


class StudyError(CoopqpError):
    """A study breaks its schema, names something that does not exist, or differs from the study that is resumed."""


class EngineError(CoopqpError):
    """The engine of a study cannot go on. Finished rows are kept: resume the study."""
