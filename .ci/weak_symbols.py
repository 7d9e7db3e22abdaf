"""Fail if object files of two builds of the arithmetic have a weak symbol in common.

Templates and inline functions are weak: of two that are named alike the linker keeps one. If it is the one for AVX2 the
other build stops at an illegal instruction on older processors; if it is the other, AVX2 is not used.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def weak(folder: Path) -> set[str]:
    """Weak symbols that object files below a folder define."""
    files = [str(file) for file in folder.rglob("*.o")]
    assert files, f"there are no object files in {folder}"
    said = subprocess.run(["nm", "--defined-only", *files], capture_output=True, text=True, check=True).stdout
    words = [line.split() for line in said.splitlines()]
    return {parts[2] for parts in words if len(parts) == 3 and parts[1] in "WwVvu"}


def main() -> int:
    """Compare the folders of object files of a build directory. Returns 1 if symbols are common."""
    folders = sorted((Path(sys.argv[1]) / "CMakeFiles").glob("*_*.dir"))
    builds = {name: [f for f in folders if f.stem.endswith(f"_{name}")] for name in ("plain", "avx2")}
    found = {name: set().union(*(weak(folder) for folder in those)) for name, those in builds.items()}
    common = sorted(found["plain"] & found["avx2"])
    numbers = ", ".join(f"{name} {len(symbols)}" for name, symbols in found.items())
    print(f"weak symbols: {numbers}; common to both builds: {len(common)}", *common, sep="\n  ")
    return int(bool(common))


if __name__ == "__main__":
    sys.exit(main())
