"""The command: coopqp run, view, report, export, demo."""
