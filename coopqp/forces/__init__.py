"""Forces between the arms and the object."""
