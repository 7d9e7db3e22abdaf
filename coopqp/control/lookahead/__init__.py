"""The path ahead of the object: where limits and singularities bind, and how fast the object may go."""
