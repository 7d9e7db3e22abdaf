"""Where the command begins: Ctrl-C during its imports, too, ends it in one line."""

import sys


def main() -> int:
    """Run :func:`coopqp.cli.main.main`."""
    try:
        from coopqp.cli.main import main as run

        return run()
    except KeyboardInterrupt:
        print("coopqp: interrupted", file=sys.stderr)
        return 130
