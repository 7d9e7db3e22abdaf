"""Visualisation: plots, timeline, renderer, viewer, report."""
