"""Errors of studies."""

from __future__ import annotations

from coopqp.errors import CoopqpError


class StudyError(CoopqpError):
    """A study is missing, breaks its schema, asks for what there is not, or is not the one that is resumed."""


class EngineError(CoopqpError):
    """The engine of a study cannot go on. Finished rows are kept: resume the study."""
