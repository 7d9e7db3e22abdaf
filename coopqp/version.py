"""The version of coopqp, below all packages: what they write names it."""

__version__ = "0.3.0"
