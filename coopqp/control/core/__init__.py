"""The core of a step seen from Python: its memory, and the loop that calls it."""
