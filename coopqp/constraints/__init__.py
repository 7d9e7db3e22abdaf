"""Further constraints, before the motion and in it: rows on joint velocities, bounds of the path speed, causes."""
