"""Verdicts on runs, by other ways than the controllers'."""
