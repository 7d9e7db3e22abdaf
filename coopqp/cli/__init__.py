"""The command ``coopqp`` and its subcommands."""
