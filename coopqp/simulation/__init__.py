"""Runs: plants, the loop, recordings, and what they amount to."""
