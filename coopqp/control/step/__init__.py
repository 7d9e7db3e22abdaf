"""One step: from the measured configuration to the command: what goes into the core, and what comes out."""
