"""Robots by name or file, wherever they are installed: coopqp's own, and URDFs of other packages on this machine."""

from __future__ import annotations

import os
import re
from importlib import metadata, util
from pathlib import Path

from coopqp.errors import UnknownNameError
from coopqp.scenarios.arms import ROBOTS, robot_file

#: Where ``robot_descriptions`` keeps what it has downloaded, unless its variable says so.
_CACHE = "~/.cache/robot_descriptions"


def find_robot(name: str) -> Path:
    """The URDF of a robot: a file, a robot of :data:`coopqp.scenarios.ROBOTS`, or one of an installed package.

    Of other packages ``NAME.urdf`` is taken, and of ``robot_descriptions`` the description ``NAME`` or
    ``NAME_description`` if its data have been downloaded before: nothing is downloaded here.

    Raises:
        UnknownNameError: there is no such file or robot.
        MissingExtraError: a robot of coopqp's list needs the extra ``robots``.
    """
    if Path(name).is_file():
        return Path(name)
    if name in ROBOTS:
        return robot_file(name)
    found = None if "/" in name or name.endswith(".urdf") else _of_packages(name) or _of_descriptions(name)
    if found is None:
        raise UnknownNameError("file or robot", name, ROBOTS)
    return found


def _of_packages(name: str) -> Path | None:
    """``NAME.urdf`` of an installed package."""
    wanted = f"{name}.urdf".lower()
    for package in metadata.distributions():
        for file in package.files or ():
            if file.name.lower() == wanted and (path := Path(str(package.locate_file(file)))).is_file():
                return path.resolve()
    return None


def _of_descriptions(name: str) -> Path | None:
    """The URDF of a description of ``robot_descriptions`` whose repository is on this machine already."""
    package = util.find_spec("robot_descriptions")
    if package is None or package.origin is None or not name.isidentifier():
        return None
    for module in (name, f"{name}_description"):
        source = Path(package.origin).with_name(f"{module}.py")
        if not source.is_file():
            continue
        repository = re.search(r"clone_to_cache\(\s*[\"']([\w.-]+)[\"']", source.read_text(encoding="utf-8"))
        cache = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", _CACHE)).expanduser()
        if repository is None or not (cache / repository[1]).is_dir():
            continue
        import importlib

        urdf = getattr(importlib.import_module(f"robot_descriptions.{module}"), "URDF_PATH", "")
        if urdf and Path(urdf).is_file():
            return Path(urdf)
    return None
