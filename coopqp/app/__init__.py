"""The command ``coopqp``: run, schema, view, report, export, demo."""
