"""Mesh files as coal loads them, in metres."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import coal
import numpy as np

from coopqp.reading import open_file
from coopqp.spatial import Array

#: Largest accepted mesh file [bytes], and where the unit of a DAE stands in it.
MOST_BYTES, _HEAD = 100_000_000, 65_536


def load_mesh(file: Path, scale: Array) -> Any:
    """A mesh file (STL, DAE, OBJ) as a coal geometry [m].

    Args:
        file: its path.
        scale: factors of its axes (3,), beside the unit that a DAE tells.

    Raises:
        OSError: it cannot be opened.
        ValueError, RuntimeError: it is no mesh.
    """
    return coal.MeshLoader().load(str(file), np.asarray(scale, dtype=float) * mesh_unit(file))


def mesh_unit(file: Path) -> float:
    """The unit of a mesh file [m]: what a DAE tells, which coal does not read; else 1. Errors as :func:`load_mesh`."""
    if file.suffix.lower() != ".dae":
        return 1.0
    with open_file(file, MOST_BYTES) as stream:
        found = re.search(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']([^\"']*)[\"']", stream.read(_HEAD))
    unit = float(found[1]) if found else 1.0
    if not (math.isfinite(unit) and unit > 0.0):
        raise ValueError(f"its unit is {unit:g} m")
    return unit
