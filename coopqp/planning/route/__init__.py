"""The search for a way round: :func:`coopqp.find_path` and its parts."""
