"""Pictures: plots, renderer, viewer, report."""
