"""Controllers: the paper's algorithm (baseline) and the QP."""
