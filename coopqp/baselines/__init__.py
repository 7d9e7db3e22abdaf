"""Controllers to compare with: the paper's pseudo-inverse, and one QP for each arm alone."""
