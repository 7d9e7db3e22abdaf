"""The page of an operator: it shows a run live, and leads it."""
