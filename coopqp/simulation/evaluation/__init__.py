"""Evaluation of runs, independent of the controllers."""
