"""Runs as arrays: gathered, described, saved and loaded."""
