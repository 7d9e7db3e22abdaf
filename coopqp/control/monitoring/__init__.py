"""Comparison of what was commanded with what is measured: supervision, drift, servos, the distance of the arms."""
