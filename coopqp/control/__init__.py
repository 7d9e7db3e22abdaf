"""One step: limits, forms, ranks, supervision, and the controllers."""
