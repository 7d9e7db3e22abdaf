"""Read malicious files in a process with bounded memory and time; prints the result of each file as JSON.

``python load_untrusted.py FOLDER`` reads every file in the folder according to its suffix.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any

from coopqp import Arm, CoopqpError, Recording, load_cell_file


def read(file: Path) -> Any:
    if file.suffix == ".urdf":
        return Arm.from_urdf("arm", file, tool_frame="tool")
    if file.suffix == ".xml":
        return Arm.from_mjcf("arm", file, tool_frame="tool")
    if file.suffix in (".toml", ".yaml"):
        return load_cell_file(file)
    return Recording.load(file)


def main(folder: Path) -> None:
    load_cell_file  # noqa: B018  (imported before memory is bounded)
    at_start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
    found = {}
    for file in sorted(folder.iterdir()):
        try:
            got = read(file)
            text = " ".join([*got.model.names, *(f.name for f in got.model.frames)]) if isinstance(got, Arm) else ""
            found[file.name] = ["read", text]
        except CoopqpError as error:
            found[file.name] = [type(error).__name__, str(error)]
        except Exception as error:  # any other exception is a failure
            found[file.name] = ["OTHER", repr(error)]
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - at_start
    print()
    print(json.dumps({"found": found, "grown_MiB": grown / 1024.0}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
