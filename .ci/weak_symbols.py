"""Fail if object files of two builds of the arithmetic have a weak symbol in common, or ask for memory of the heap.

Templates and inline functions are weak: of two that are named alike the linker keeps one. If it is the one for AVX2 the
other build stops at an illegal instruction on older processors; if it is the other, AVX2 is not used.

A step may not wait for memory: Eigen's matrices there have fixed or bounded sizes.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

#: What asks for memory of the heap: C's functions, and C++'s operators new.
HEAP = {"malloc", "calloc", "realloc", "aligned_alloc", "posix_memalign", "_Znwm", "_Znam", "_ZnwmSt11align_val_t"}


def symbols(folder: Path) -> list[tuple[str, str]]:
    """Kinds and names of the symbols of object files below a folder."""
    files = [str(file) for file in folder.rglob("*.o")]
    assert files, f"there are no object files in {folder}"
    said = subprocess.run(["nm", *files], capture_output=True, text=True, check=True).stdout
    words = [line.split() for line in said.splitlines()]
    return [(parts[-2], parts[-1]) for parts in words if len(parts) in (2, 3)]


def weak(folder: Path) -> set[str]:
    """Weak symbols that object files below a folder define."""
    return {name for kind, name in symbols(folder) if kind in "WVvu"}


def heap(folder: Path) -> set[str]:
    """Functions of the heap that they call; macOS puts an underscore before each name."""
    return {name for kind, name in symbols(folder) if kind == "U" and {name, name[1:]} & HEAP}


def main() -> int:
    """Look at the folders of object files of a build directory. Returns 1 if symbols are common, or of the heap."""
    folders = sorted((Path(sys.argv[1]) / "CMakeFiles").glob("*_*.dir"))
    builds = {name: [f for f in folders if f.stem.endswith(f"_{name}")] for name in ("plain", "avx2")}
    found = {name: set().union(*(weak(folder) for folder in those)) for name, those in builds.items()}
    common = sorted(found["plain"] & found["avx2"])
    numbers = ", ".join(f"{name} {len(symbols)}" for name, symbols in found.items())
    print(f"weak symbols: {numbers}; common to both builds: {len(common)}", *common, sep="\n  ")
    asked = sorted(set().union(*(heap(folder) for those in builds.values() for folder in those)))
    print(f"functions of the heap that the arithmetic calls: {len(asked)}", *asked, sep="\n  ")
    return int(bool(common or asked))


if __name__ == "__main__":
    sys.exit(main())
