"""The parts of tests/mutation.py: what is changed, in what copy, and which tests look at it."""
