"""Programs in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys


def python(*arguments: object, timeout: float = 120.0, **environment: str) -> subprocess.CompletedProcess[str]:
    """Python with these arguments, BLAS on one thread, and other variables of the environment; it may fail."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **environment},
    )


def output(*arguments: object, timeout: float = 120.0, **environment: str) -> str:
    """What Python prints that does not fail."""
    done = python(*arguments, timeout=timeout, **environment)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout
