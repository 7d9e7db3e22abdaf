"""Files of strangers that are no ordinary ones, nested deep or have endless names: one named error, at once.

A reader that waits for a pipe or reads a device without end never returns: the suite's own limit ends it.
"""

from __future__ import annotations

import json
import os
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coopqp import Arm, CoopqpError, Recording, load_cell_file
from coopqp.collision.pairs import srdf_pairs
from coopqp.errors import ModelError, UnknownNameError, nearest
from coopqp.files.cellfile.text import read_tables
from coopqp.model.description import MAX_LINKS
from coopqp.model.shapes import Mesh
from coopqp.model.tool_guess import guess_tool
from coopqp.simulation.events import read_script
from coopqp.studies import load_place_study, load_study
from coopqp.studies.errors import StudyError
from coopqp.studies.journal import Journal

JOINT = (
    '<joint name="j{0}" type="fixed"><parent link="l{0}"/><child link="l{1}"/></joint>',
    '<joint name="j" type="revolute"><parent link="base"/><child link="t"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>',
)
ROBOT = f'<robot name="r"><link name="base"/><link name="t"/>{JOINT[1]}</robot>'


def _study(folder: Path, cell: Path) -> None:
    file = folder / "study.toml"
    file.write_text(f"name = 's'\ncell = '{cell}'\n")
    load_study(file)


#: What reads a file: from a folder for more files, and the file.
READERS: dict[str, Callable[[Path, Path], object]] = {
    "cell": lambda _, file: load_cell_file(file),
    "study": lambda _, file: load_study(file),
    "cell of a study": _study,
    "place study": lambda _, file: load_place_study(file),
    "URDF": lambda _, file: Arm.from_urdf("a", file, tool_frame="t"),
    "URDF whose tool is guessed": lambda _, file: guess_tool(file),
    "MJCF": lambda _, file: Arm.from_mjcf("a", file, tool_frame="t", velocity_limits=1.0),
    "SRDF": lambda _, file: srdf_pairs(file, "a scene"),
    "mesh": lambda _, file: Mesh(file),
    "recording": lambda _, file: Recording.load(file),
    "script": lambda _, file: read_script(file, 0.002),
    "journal": lambda _, file: Journal(file),
}


@pytest.mark.skipif(sys.platform != "linux", reason="files of Linux")
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_ordinary_file_is_refused_by_every_reader(
    reader: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe, secret = tmp_path / "pipe", tmp_path / "secret"
    os.mkfifo(pipe)
    secret.write_text("")
    plain = os.open
    refused = PermissionError(13, "Permission denied")  # root may read everything

    def opened(file: Any, *arguments: Any, **named: Any) -> int:
        if Path(file) == secret:
            raise refused
        return plain(file, *arguments, **named)

    monkeypatch.setattr(os, "open", opened)
    for file, said in (
        (Path("/dev/zero"), "no ordinary file"), (pipe, "no ordinary file"), (tmp_path, "it is a folder"),
        (secret, "Permission denied"), (tmp_path / ("x" * 300), "File name too long"), (tmp_path / "\0", "no path"),
    ):  # fmt: skip
        if reader == "cell of a study" and "\0" in str(file):
            continue  # TOML has no such character
        with pytest.raises(CoopqpError, match=said) as caught:
            READERS[reader](tmp_path, file)
        assert len(str(caught.value)) < 1000
    if reader not in ("mesh", "journal"):  # a mesh is opened by its reader; a journal is written
        with pytest.raises(CoopqpError, match=r"Input/output|Permission|not|no"):
            READERS[reader](tmp_path, Path("/proc/self/mem"))


@pytest.mark.skipif(sys.platform != "linux", reason="files of Linux")
@pytest.mark.parametrize("kind", ["mesh", "include", "part of an include", "model"])
def test_what_an_mjcf_names_is_looked_at_before_it_is_read(kind: str, tmp_path: Path) -> None:
    """MuJoCo would wait for a pipe."""
    pipe, file, part = tmp_path / "parts" / "pipe.stl", tmp_path / "a.xml", tmp_path / "part.xml"
    pipe.parent.mkdir()
    os.mkfifo(pipe)
    mesh = '<compiler meshdir="parts"/><asset><mesh name="m" file="pipe.stl"/></asset>'
    part.write_text(f"<mujoco>{mesh}</mujoco>")
    inside = {
        "mesh": mesh, "include": '<include file="parts/pipe.stl"/>', "part of an include": '<include file="part.xml"/>',
        "model": '<asset><model name="m" file="part.xml"/></asset>',
    }[kind]  # fmt: skip
    file.write_text(f'<mujoco>{inside}<worldbody><body name="t"><joint name="j"/></body></worldbody></mujoco>')
    with pytest.raises(ModelError, match=r"pipe\.stl.*no ordinary file"):
        Arm.from_mjcf("a", file, tool_frame="t", velocity_limits=1.0)


def test_what_is_nested_deep_is_refused_by_name(tmp_path: Path) -> None:
    file, deep = tmp_path / "a.toml", ".".join(["a"] * 3000)
    for text in (f"{deep} = 1", f"[{deep}]", f"x = {'[' * 400}{']' * 400}", f"[[{deep}]]"):
        file.write_text(text)
        with pytest.raises(CoopqpError, match=r"nested|recursion|not TOML"):
            read_tables(file)
    for text in (f'set = {{ "{deep}" = 1 }}', f'axes = {{ "{deep}" = [1] }}',
                 f'cases = [{{ name = "c", set = {{ "{deep}" = 1 }} }}]'):  # fmt: skip
        file.write_text(f'name = "s"\nscenario = "paper_lift"\n{text}\n')
        with pytest.raises(StudyError, match="has 3000 parts; at most 50"):
            load_study(file)


def test_a_journal_whose_checksums_hold_may_still_be_none(tmp_path: Path) -> None:
    for text in ("[" * 100_000, '["row"]', '{"row": ' + "[" * 200 + "]" * 200 + "}"):
        head = (text[:-1] if text.endswith("}") else text).encode()
        mark = f"{zlib.crc32(head + b'}'):08x}"
        line = head + b', "crc": "' + mark.encode() + b'"}\n'
        (tmp_path / "journal").write_bytes(line)
        with pytest.raises(StudyError, match="line 1 is damaged"):
            Journal(tmp_path / "journal")


def test_a_recording_that_is_nested_deep_is_none(tmp_path: Path) -> None:
    inner: Any = 1
    for _ in range(300):
        inner = {"a": inner}
    text = np.array(json.dumps({"notes": [], "metadata": inner}))
    small = {"time": np.zeros(1), "q": np.zeros((1, 1)), "q_command": np.zeros((1, 1)), "velocity": np.zeros((0, 1)),
             "clock": np.zeros(1), "rate": np.zeros(0), "status": np.zeros(0, int), "reference": np.zeros((1, 4, 4)),
             "T_object_tool": np.zeros((1, 4, 4))}  # fmt: skip
    np.savez(tmp_path / "run.npz", text=text, **small)
    with pytest.raises(CoopqpError, match="nested more than 100 deep"):
        Recording.load(tmp_path / "run.npz")


def test_a_chain_of_too_many_links_is_refused(tmp_path: Path) -> None:
    """Pinocchio's reader follows it recursively, and the process would end."""
    file, links = tmp_path / "a.urdf", MAX_LINKS + 1
    chain = [f'<link name="l{i}"/>' for i in range(links)] + [JOINT[0].format(i, i + 1) for i in range(links - 1)]
    file.write_text(f'<robot name="r">{"".join(chain)}</robot>')
    with pytest.raises(ModelError, match=f"more than {MAX_LINKS} links"):
        Arm.from_urdf("a", file, tool_frame="l0")


def test_endless_names_make_short_messages(tmp_path: Path) -> None:
    file, long = tmp_path / "a.urdf", "a" * 300_000
    links = "".join(f'<link name="{long}{i}"/>{JOINT[0]}'.replace("l{0}", "base").replace("l{1}", f"{long}{i}")
                    .replace("j{0}", f"f{i}") for i in range(10))  # fmt: skip
    file.write_text(ROBOT.replace("</robot>", f"{links}</robot>"))
    for call in (
        lambda: Arm.from_urdf("a", file, tool_frame="a" * 99 + "b", geometry=False),
        lambda: Arm.from_urdf("a", file, tool_frame="t", geometry=False, locked_joints={long: 0.0}),
        lambda: guess_tool(file, tool_frame=long),
    ):
        with pytest.raises(CoopqpError) as caught:
            call()
        assert len(str(caught.value)) < 5000
    cell = tmp_path / "cell.toml"
    cell.write_text(f'{long} = 1\n[grasp]\nkind = "{long}"\n')
    with pytest.raises(CoopqpError) as caught:
        load_cell_file(cell)
    assert len(str(caught.value)) < 5000


def test_suggestions_are_those_of_short_names() -> None:
    names = [f"joint_{i}" for i in range(300)]
    assert nearest("jonit_7", names) == ["joint_7"]
    assert nearest("x" * 10**6, ["x" * 10**6 + str(i) for i in range(10)], most=2, cutoff=0.0) != []
    error = UnknownNameError("joint", "jonit_7", names)
    assert "Did you mean 'joint_7'?" in str(error)
    assert "joint_59, and 240 more" in str(error)
    assert error.available == tuple(names)


def test_a_mark_at_the_beginning_is_no_text(tmp_path: Path) -> None:
    """Windows editors write it."""
    mark = "\N{ZERO WIDTH NO-BREAK SPACE}"
    for name, text in (("a.toml", "dt_s = 0.1"), ("a.yaml", "dt_s: 0.1")):
        (tmp_path / name).write_text(mark + text, encoding="utf-8")
        assert read_tables(tmp_path / name) == {"dt_s": 0.1}
    (tmp_path / "script").write_text(f"{mark}1.0 pause", encoding="utf-8")
    assert [event.call for event in read_script(tmp_path / "script", 0.1)] == ["pause"]
    (tmp_path / "a.srdf").write_text(
        f'{mark}<robot name="r"><disable_collisions link1="a" link2="b"/></robot>', encoding="utf-8"
    )
    assert srdf_pairs(tmp_path / "a.srdf", "") == [("a", "b")]
    (tmp_path / "a.urdf").write_text(mark + ROBOT, encoding="utf-8")
    assert Arm.from_urdf("a", tmp_path / "a.urdf", tool_frame="t").model.names[1] == "j"
