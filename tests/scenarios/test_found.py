"""Robots by name: of coopqp's list, of other packages, of descriptions that were downloaded before."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from coopqp.errors import UnknownNameError
from coopqp.scenarios.found import find_robot
from coopqp.scenarios.robots import robot_path

DESCRIPTION = """
from ._cache import clone_to_cache as _clone_to_cache
REPOSITORY_PATH = _clone_to_cache("arms_repository")
URDF_PATH = REPOSITORY_PATH + "/arm.urdf"
"""


def test_a_file_and_a_robot_of_the_list(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text("<robot/>")
    assert find_robot(str(file)) == file
    assert find_robot("rx90l") == robot_path("rx90l")


def test_a_urdf_of_another_package_is_found_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "arms_of_tomorrow-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: arms-of-tomorrow\nVersion: 1\n")
    (info / "RECORD").write_text("arms/Tomorrow9.urdf,,\narms/gone9.urdf,,\n")
    (tmp_path / "arms").mkdir()
    (tmp_path / "arms" / "Tomorrow9.urdf").write_text("<robot/>")
    monkeypatch.syspath_prepend(tmp_path)
    assert find_robot("tomorrow9") == (tmp_path / "arms" / "Tomorrow9.urdf").resolve()
    with pytest.raises(UnknownNameError, match="no file or robot named 'gone9'"):
        find_robot("gone9")


def test_a_description_is_taken_only_where_its_data_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Importing one downloads its data: it is not imported before they are there."""
    package, cache = tmp_path / "robot_descriptions", tmp_path / "cache"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "_cache.py").write_text(
        f"def clone_to_cache(name):\n    path = {str(cache)!r} + '/' + name\n"
        "    import os\n    assert os.path.isdir(path), 'a download'\n    return path\n"
    )
    (package / "arm9_description.py").write_text(DESCRIPTION)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(cache))
    for name in [name for name in sys.modules if name.partition(".")[0] == "robot_descriptions"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(UnknownNameError, match="arm9"):
        find_robot("arm9")
    (cache / "arms_repository").mkdir(parents=True)
    (cache / "arms_repository" / "arm.urdf").write_text("<robot/>")
    assert find_robot("arm9") == cache / "arms_repository" / "arm.urdf"
    assert find_robot("arm9_description") == cache / "arms_repository" / "arm.urdf"
    for name in [name for name in sys.modules if name.partition(".")[0] == "robot_descriptions"]:
        del sys.modules[name]
