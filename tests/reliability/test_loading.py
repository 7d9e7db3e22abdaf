"""Untrusted files: nothing in them is executed, sizes are bounded, errors are named; and files cut by a kill."""

from __future__ import annotations

import io
import json
import os
import pickle
import signal
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coopqp import QPController, Recording, simulate
from coopqp.scenarios import paper_lift

PROGRAM = Path(__file__).with_name("programs") / "load_untrusted.py"
SECRET = "the_content_of_another_file"
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@pytest.fixture(scope="module", name="run")
def _run() -> Recording:
    lift = paper_lift()
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.1)
    return simulate(controller, q_start=lift.q_start, duration=0.3)


# -- robot descriptions ------------------------------------------------------------------------------------------------

JOINT = (
    '<joint name="{name}" type="revolute"><parent link="base"/><child link="tool"/><axis xyz="0 0 1"/>{limit}</joint>'
)
LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'


def urdf(head: str = "", name: str = "joint", inside: str = "") -> str:
    joint = JOINT.format(name=name, limit=LIMIT)
    return f'<?xml version="1.0"?>{head}<robot name="r"><link name="base"/><link name="tool"/>{joint}{inside}</robot>'


def mjcf(head: str = "", name: str = "joint", inside: str = "") -> str:
    body = f'<body name="tool"><joint name="{name}" type="hinge" axis="0 0 1"/><geom type="sphere" size=".1"/></body>'
    return f'<?xml version="1.0"?>{head}<mujoco model="m">{inside}<worldbody>{body}</worldbody></mujoco>'


def laughs(levels: int = 14) -> str:
    """Nested entities that expand to 10**levels copies."""
    lines = [f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(levels)]
    return f'<!DOCTYPE r [<!ENTITY e0 "ha">{"".join(lines)}]>'


def descriptions(secret: Path) -> dict[str, str]:
    outside = f'<!DOCTYPE r [<!ENTITY x SYSTEM "file://{secret}">]>'
    parameter = f'<!DOCTYPE r [<!ENTITY % x SYSTEM "file://{secret}"> %x;]>'
    whole = f'<!DOCTYPE r SYSTEM "file://{secret}">'
    mesh = f'<geometry><mesh filename="file://{secret}"/></geometry>'
    files = {}
    for suffix, make in (("urdf", urdf), ("xml", mjcf)):
        files |= {
            f"entities.{suffix}": make(laughs(), "&e14;"),
            f"external.{suffix}": make(outside, "&x;"),
            f"parameter.{suffix}": make(parameter),
            f"external_dtd.{suffix}": make(whole),
            f"deep.{suffix}": make(inside="<a>" * 500_000 + "</a>" * 500_000),
            f"long_name.{suffix}": make(name="j" * 1_000_000),
            f"instruction.{suffix}": make('<?xml-stylesheet href="x" type="text/xsl"?><?php system("true"); ?>'),
        }
    files["bodies.xml"] = mjcf(inside=f"<worldbody>{'<body>' * 100_000}{'</body>' * 100_000}</worldbody>")
    files["include.xml"] = mjcf(inside=f'<include file="{secret}"/>')
    files["mesh.urdf"] = urdf(inside=f'<link name="l"><visual>{mesh}</visual></link>')
    files["mesh.xml"] = mjcf(inside=f'<asset><mesh name="m" file="{secret}"/></asset>')
    return files


# -- recordings --------------------------------------------------------------------------------------------------------


class Trap:
    """An object that creates a folder when it is unpickled."""

    def __init__(self, place: Path) -> None:
        self.place = str(place)

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (self.place,)


def npy(header: str, data: bytes = b"") -> bytes:
    """An array file with any header."""
    text = header.encode() + b" " * 16 + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def packed(entries: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return stream.getvalue()


def recordings(run: Recording, trap: Path, tmp_path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(run.save(tmp_path / "sound.npz")) as archive:
        sound = {name: archive.read(name) for name in archive.namelist()}

    def with_(**changed: bytes) -> bytes:
        return packed(sound | {f"{name}.npy": content for name, content in changed.items()})

    objects = io.BytesIO()
    np.save(objects, np.array([Trap(trap)], dtype=object), allow_pickle=True)
    zeros = npy("{'descr': '<f8', 'fortran_order': False, 'shape': (250000,), }", b"\0" * 2_000_000)
    lying = {}
    for claimed in (1_900_000_000, 2_100_000_000, 16):
        content = bytearray(with_(q=zeros))
        at = content.rfind(b"PK\x01\x02", 0, content.rfind(b"q.npy"))
        content[at + 24 : at + 28] = struct.pack("<I", claimed)  # the claimed size of this entry
        lying[f"claims_{claimed}.npz"] = bytes(content)
    deep = io.BytesIO()
    np.save(deep, np.array("[" * 100_000))
    return {
        "objects.npz": with_(q=objects.getvalue()),
        "text_objects.npz": with_(text=objects.getvalue()),
        "pickle.npz": pickle.dumps(Trap(trap)),
        "huge_shape.npz": with_(q=npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }")),
        "overflowing_shape.npz": with_(q=npy("{'descr': '<f8', 'fortran_order': False, 'shape': (2**62, 2**62), }")),
        "negative_shape.npz": with_(q=npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }")),
        "huge_text.npz": with_(text=npy("{'descr': '<U500000000', 'fortran_order': False, 'shape': (), }")),
        "code.npz": with_(q=npy(f"__import__('os').mkdir({str(trap)!r})")),
        "code_type.npz": with_(q=npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", b"cos\nsystem\n")),
        **lying,
        "deep_text.npz": with_(text=deep.getvalue()),
        "elsewhere.npz": packed({f"../../{name}": content for name, content in sound.items()}),
        "empty.npz": packed({}),
    }


CELL_FILES = {
    "deep_keys.toml": "a" + ".a" * 5000 + " = 1",
    "deep_arrays.toml": "a = " + "[" * 5000 + "]" * 5000,
    "many.toml": "\n".join(f"k{i} = {i}" for i in range(50_000)),
    "not_utf8.toml": "x = '\udcff'",
    "model_elsewhere.toml": '[[arms]]\nname = "a"\nurdf = "/etc/passwd"\ntool_frame = "tool"\n',
    "numbers.toml": "x = " + "9" * 6000,
    "object.yaml": "a: !!python/object/apply:os.system ['touch trap']",
    "aliases.yaml": "a: &a [x]\n"
    + "\n".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]" for a, b in pairwise("abcdefghij")),
    "deep.yaml": "[" * 5000,
    "deep_keys.yaml": "".join(" " * i + "a:\n" for i in range(400)),
    "numbers.yaml": "x: " + "9" * 6000,
    "many.yaml": "\n".join(f"k{i}: {i}" for i in range(9_000)),
}


@pytest.mark.slow
def test_files_that_mean_no_good(run: Recording, tmp_path: Path, catalogue: Any) -> None:
    folder, trap, secret = tmp_path / "files", tmp_path / "trap", tmp_path / "secret.txt"
    folder.mkdir()
    secret.write_text(SECRET)
    files: dict[str, bytes] = {n: t.encode() for n, t in descriptions(secret).items()}
    files |= {n: t.encode("utf-8", "surrogateescape") for n, t in CELL_FILES.items()}
    files |= (bad_recordings := recordings(run, trap, tmp_path))
    for name, content in files.items():
        (folder / name).write_bytes(content)
    done = subprocess.run(
        [sys.executable, str(PROGRAM), str(folder)],
        capture_output=True, text=True, timeout=120, env=ENVIRONMENT, check=False,
    )  # fmt: skip
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])
    answer = json.loads(done.stdout.splitlines()[-1])
    found = answer["found"]
    assert len(found) == len(files)
    assert not trap.exists()
    assert not [n for n, (_, text) in found.items() if SECRET in text]
    other = {n: text for n, (kind, text) in found.items() if kind == "OTHER"}
    assert not other
    refused = {n for n, (kind, _) in found.items() if kind != "read"}
    assert refused >= bad_recordings.keys() | CELL_FILES.keys()
    catalogue.row(
        "C",
        "files that mean no good: executed, leaked, or an error without a name",
        cases=len(files),
        measured=len(other) + trap.exists(),
        target=0,
        unit="failures",
        note=f"URDF, MJCF, cell files, recordings; {len(refused)} refused, the others hold nothing that is not theirs",
    )
    catalogue.row(
        "C", "files that mean no good: memory", cases=len(files), measured=answer["grown_MiB"], target=512.0, unit="MiB"
    )


# -- writing -----------------------------------------------------------------------------------------------------------

KILLED = """
import os, signal, sys
from dataclasses import replace
from pathlib import Path
from coopqp import Recording
file, where = Path(sys.argv[1]), sys.argv[2]
recording = Recording.load(file)
new = replace(recording, metadata=dict(recording.metadata, version="new"))

def die(*a, **k):
    os.kill(os.getpid(), signal.SIGKILL)

if where == "before":
    Path.replace = die
else:
    opened = Path.open
    class Half:
        def __init__(self, stream): self.stream = stream
        def __enter__(self): return self
        def __exit__(self, *a): self.stream.close()
        def write(self, content):
            self.stream.write(content[: int(len(content) * float(where))])
            self.stream.flush()
            die()
    Path.open = lambda self, *a, **k: Half(opened(self, *a, **k))
new.save(file)
"""


@pytest.mark.slow
def test_a_kill_while_writing_leaves_the_old_file(
    run: Recording, tmp_path: Path, count: Callable[[int], int], catalogue: Any
) -> None:
    file = run.save(tmp_path / "run.npz")
    before, damaged = file.read_bytes(), 0
    moments = ["before", *(str(x) for x in np.linspace(0.0, 1.0, count(3)))]
    for where in moments:
        command = [sys.executable, "-c", KILLED, str(file), where]
        done = subprocess.run(command, env=ENVIRONMENT, timeout=60, check=False)
        assert done.returncode == -signal.SIGKILL
        damaged += file.read_bytes() != before
    Recording.load(file)
    catalogue.row(
        "C", "a recording killed while it is written: old file lost", cases=len(moments), measured=damaged, target=0
    )
