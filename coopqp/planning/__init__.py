"""Ahead of the clock: the path preview."""
