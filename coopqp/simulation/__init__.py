"""Runs: plants, the control loop, recordings, monitoring and assessment."""
