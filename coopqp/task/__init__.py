"""What the object should do: paths, whose error counts, posture."""
