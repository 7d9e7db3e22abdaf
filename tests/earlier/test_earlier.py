"""What version 0.2 wrote is read, with the same numbers; what is gone is one error that says what replaces it."""

from __future__ import annotations

import importlib
import json
import lzma
import pickle
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numbers_read import numbers_of, sums_of
from places import ROOT

from coopqp import CoopqpError, InvalidInputError, Recording, load_cell_file
from coopqp.errors import RemovedNameError
from coopqp.files import CellFileError
from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.text import read_tables
from coopqp.simulation import chain_error, events_of, tool_placements
from coopqp.studies import Local, StudyError, load_study, sweep

KEPT = Path(__file__).parent / "kept"
WRITTEN = json.loads(lzma.decompress((KEPT / "numbers.json.xz").read_bytes()))


#: The models in these pickles are archives of Pinocchio 4, which earlier ones refuse.
needs_its_archives = pytest.mark.skipif(int(pin.__version__.partition(".")[0]) < 4, reason="archives of Pinocchio 4")


def unpickled(name: str) -> Any:
    return pickle.loads(lzma.decompress((KEPT / f"{name}.pkl.xz").read_bytes()))


def same(found: Any, written: Any) -> None:
    """Texts alike, numbers within rounding."""
    if isinstance(written, dict):
        assert found.keys() == written.keys()
        for key in written:
            same(found[key], written[key])
    elif isinstance(written, list) and any(isinstance(value, (str, dict)) for value in written):
        assert found == written
    elif isinstance(written, (float, list)):
        np.testing.assert_allclose(found, written, rtol=1e-9, atol=1e-9)
    else:
        assert found == written


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning", "ignore::coopqp.errors.StiffnessWarning")
@pytest.mark.parametrize("name", WRITTEN["cells"])
def test_a_cell_file_is_read_as_it_was(name: str) -> None:
    """Together the files use every key of version 0.2 but the three that are gone."""
    file, written = KEPT / "cells" / f"{name}.toml", WRITTEN["cells"][name]
    settings = CellFile.model_validate(read_tables(file))
    assert settings.model_dump(mode="json", exclude_unset=True) == written["settings"]
    if "numbers" in written:
        same(numbers_of(load_cell_file(file)), written["numbers"])


@pytest.mark.parametrize("key", ['form = "full"', "iterations = 2", 'kernel = "plain"'])
def test_a_key_that_is_gone_is_one_error(key: str, tmp_path: Path) -> None:
    shutil.copytree(KEPT / "cells", tmp_path / "cells")
    file = tmp_path / "cells" / "bar.toml"
    file.write_text(file.read_text(encoding="utf-8").replace("[controller]", f"[controller]\n{key}"), encoding="utf-8")
    with pytest.raises(CellFileError, match=rf"controller: {key.split()[0]} is no longer a key; leave it out: "):
        load_cell_file(file)


@pytest.mark.parametrize("name", WRITTEN["runs"])
def test_a_recording_is_read_as_it_was(name: str) -> None:
    run = Recording.load(KEPT / f"{name}.npz")
    same(sums_of(run), WRITTEN["runs"][name])
    assert {"forces": 1, "program": 1}.get(name, 0) == (run.shift is not None)
    assert (run.wrenches is not None) == (name == "forces")
    assert [event.call for event in events_of(run)] == {
        "program": ["signal"],
        "operator": ["pause", "jog", "return_to_path", "forward"],
    }.get(name, [])
    assert len(run.bindings) == run.n_steps


def test_a_study_is_the_one_that_it_was(tmp_path: Path) -> None:
    study, made, written = unpickled("study"), unpickled("sweep"), WRITTEN["study"]
    assert study.digest == made.study.digest == written["digest"] == load_study(KEPT / "study.toml").digest
    assert list(made.columns) == written["columns"]
    for row, earlier in zip(made.rows, written["rows"], strict=True):
        same({**row, "closest_mm": 0.0}, {**earlier, "closest_mm": 0.0})
    shutil.copytree(KEPT / "study", tmp_path / "study")
    with pytest.raises(StudyError, match=r"was begun with .*coopqp 0\.2\.0 \(now .*Give another folder"):
        sweep(study, Local(1), tmp_path / "study", resume=True)


@needs_its_archives
def test_options_and_a_scenario_come_out_of_their_pickles() -> None:
    options, task = unpickled("options"), unpickled("scenario")
    assert (options.path_gain, options.weights.grasp, options.weights.chain) == (7.0, 2.0, 1e8)
    assert task.cell.arm_names == ("master", "slave_1", "slave_2")
    assert chain_error(tool_placements(task.cell, [task.q_start])[0], task.grasp)[0] < 1e-9


@needs_its_archives
@pytest.mark.parametrize("name", ["controller", "forces"])
def test_a_controller_of_another_memory_is_one_error(name: str) -> None:
    with pytest.raises(InvalidInputError, match=r"its memory is of another version\. Build and reset a new one"):
        unpickled(name)


@pytest.mark.parametrize("package", WRITTEN["names"])
def test_a_public_name_is_there_or_says_what_replaces_it(package: str) -> None:
    """And the changelog lists those that are gone."""
    said: dict[str, str] = {}
    for name in WRITTEN["names"][package]:
        try:
            exec(f"from {package} import {name}")
        except RemovedNameError as error:
            said[name] = str(error)
    assert all(text.startswith(f"{package}.{name} is gone: ") for name, text in said.items())
    gone = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").partition("\n### Removed")[2].partition("\n### New")[0]
    assert [name for name in said if not re.search(rf"\b{name}\b", gone)] == []


@pytest.mark.parametrize("name", WRITTEN["options"])
def test_an_option_is_there_or_says_what_to_do(name: str) -> None:
    package, _, kind = name.rpartition(".")
    options = getattr(importlib.import_module(package), kind)
    for field in WRITTEN["options"][name]:
        if field not in options.__dataclass_fields__:
            with pytest.raises(CoopqpError, match=f"{field} is no longer an option. Leave it out: "):
                options(**{field: None})
