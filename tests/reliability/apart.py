"""A program in a process of its own, which begins where the imports of other packages have ended.

These imports take longer than most examples. A server without threads does them once and forks a process for each
program; coopqp itself is imported by the program.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import runpy
import sys
from pathlib import Path

#: Time after which a program counts as hanging [s].
_TIMEOUT = 900.0
_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(
    ["numpy", "scipy.sparse", "pinocchio", "matplotlib.pyplot", "matplotlib.backends.backend_agg"]
)


def run_apart(file: Path, *arguments: str, folder: Path, printed: Path) -> str:
    """Run a Python program in ``folder``, like ``python file arguments…``. Returns what it prints, also in ``printed``.

    Raises:
        RuntimeError: it fails, or takes too long.
    """
    process = _SERVER.Process(target=_play, args=(str(file), arguments, str(folder), str(printed)))
    process.start()
    process.join(_TIMEOUT)
    if process.is_alive():
        process.kill()
        process.join()
    said = printed.read_text(encoding="utf-8")
    if process.exitcode:
        raise RuntimeError(f"{file.name} ends with {process.exitcode}: {said}")
    return said


def _play(file: str, arguments: tuple[str, ...], folder: str, printed: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    os.chdir(folder)
    sys.argv, sys.path[0:0] = [file, *arguments], [str(Path(file).parent)]
    with Path(printed).open("w", encoding="utf-8") as said, contextlib.redirect_stdout(said):
        runpy.run_path(file, run_name="__main__")
