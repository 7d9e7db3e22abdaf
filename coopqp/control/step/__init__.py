"""One step: from the measured configuration to the command, as the definition in Python says it."""
