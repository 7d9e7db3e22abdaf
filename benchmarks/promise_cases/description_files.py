"""Every URDF and MJCF of packages that are installed: read as Pinocchio or MuJoCo reads it, or refused with the truth.

Packages in another environment are looked at if ``COOPQP_DESCRIPTIONS`` names their folders. Those that are not there
are skipped by name. An arm is read to the end of a longest chain; all its bodies are compared at random positions.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from coopqp import Arm, CoopqpError
from coopqp.spatial import Array
from promise_cases import Promise

_PACKAGES = ("example-robot-data", "robosuite", "pybullet_data", "mujoco")
#: Bodies may be this far off [m, and rotation matrix entries]: MuJoCo normalises what a file rounds.
_OFF = 1e-6
_QUICK = 12


@dataclass
class Counts:
    """Files of one kind: all, those that are read otherwise, and those that are refused without a true reason."""

    files: int = 0
    read: int = 0
    otherwise: int = 0
    untrue: int = 0


def promises(quick: bool) -> Iterator[Promise]:
    """The promises, a package at a time."""
    rng = np.random.default_rng(43)
    for package, folder in _folders():
        if folder is None:
            print(f"skipped: the package {package} is not installed")
            continue
        for kind, judge in (("urdf", _urdf), ("xml", _mjcf)):
            files = sorted(path for path in folder.rglob(f"*.{kind}") if kind == "urdf" or _is_mjcf(path))
            counts = Counts()
            for file in files[:: max(1, len(files) // _QUICK)] if quick else files:
                judge(file, rng, counts)
            if counts.files:
                name = f"{package}: {counts.files} {'URDF' if kind == 'urdf' else 'MJCF'}, {counts.read} of them read"
                yield Promise(f"{name}: read otherwise", counts.otherwise, 0.0, "files")
                yield Promise(f"{name}: refused, not with the truth", counts.untrue, 0.0, "files")


def _folders() -> Iterator[tuple[str, Path | None]]:
    """The folder of each package, None where it is not installed."""
    elsewhere = [Path(folder) for folder in os.environ.get("COOPQP_DESCRIPTIONS", "").split(os.pathsep) if folder]
    for name in _PACKAGES:
        found = next((folder for folder in elsewhere if folder.name == name), None)
        if found is None and name == "example-robot-data":
            try:
                site = importlib.metadata.distribution(name).locate_file("cmeel.prefix/share")
                found = Path(str(site)) / name
            except importlib.metadata.PackageNotFoundError:
                found = None
        elif found is None and (spec := importlib.util.find_spec(name)) is not None and spec.origin:
            found = Path(spec.origin).parent
        yield name, found
    for folder in elsewhere:
        if folder.name not in _PACKAGES:
            yield folder.name, folder


def _is_mjcf(file: Path) -> bool:
    return "<mujoco" in file.read_text(encoding="utf-8", errors="replace")


def _read(read: Any, file: Path, tool: str) -> Arm | str:
    """The arm, or why it is refused."""
    try:
        return read("a", file, tool_frame=tool, geometry=False, velocity_limits=1.0)
    except CoopqpError as error:
        return str(error)


# -- URDF ----------------------------------------------------------------------------------------------------------


def _urdf(file: Path, rng: np.random.Generator, counts: Counts) -> None:
    counts.files += 1
    try:
        whole = pin.buildModelFromUrdf(str(file))
    except (ValueError, RuntimeError):
        answer = _read(Arm.from_urdf, file, "tool")
        if not isinstance(answer, str):
            _report(file, counts, "otherwise", "Pinocchio refuses it")
        return
    try:
        root = ElementTree.fromstring(file.read_bytes().lstrip())
    except ElementTree.ParseError:  # Pinocchio's parser takes some files that are no XML
        if "is not a readable URDF" not in (answer := str(_read(Arm.from_urdf, file, "tool"))):
            _report(file, counts, "untrue", answer)
        return
    mimics = {}
    for joint in root.findall("joint"):
        follows = joint.find("mimic")
        if follows is not None:
            factors = float(follows.get("multiplier", "1")), float(follows.get("offset", "0"))
            mimics[str(joint.get("name"))] = (str(follows.get("joint")), *factors)
    bodies = [frame for frame in whole.frames if frame.type == pin.FrameType.BODY]
    tool = max(bodies, key=lambda frame: len(whole.supports[frame.parentJoint]))
    chain = {whole.names[j] for j in whole.supports[tool.parentJoint]}
    answer = _read(Arm.from_urdf, file, tool.name)
    if isinstance(answer, str):
        if not _true_of_urdf(answer, whole, mimics, chain):
            _report(file, counts, "untrue", answer)
        return
    counts.read += 1
    x = dict(zip(list(answer.model.names)[1:], rng.uniform(-1.0, 1.0, answer.model.nv), strict=True))
    named = {name: x.get(name, _at_zero(whole, name)) for name in list(whole.names)[1:]}
    for name in mimics:  # a follower of a follower as well
        named[name] = _followed(name, mimics, named)
    if not _same(answer, x, whole, named, [frame.name for frame in bodies]):
        _report(file, counts, "otherwise", "bodies are elsewhere")


def _followed(name: str, mimics: dict[str, Any], named: dict[str, float]) -> float:
    leader, multiplier, offset = mimics[name]
    x = _followed(leader, mimics, named) if leader in mimics else named.get(leader, 0.0)
    return float(multiplier * x + offset)


def _at_zero(model: pin.Model, name: str) -> float:
    joint = model.joints[model.getJointId(name)]
    low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
    return float(np.clip(0.0, low, high)) if joint.nq == 1 and low <= high else 0.0


def _set(model: pin.Model, named: dict[str, float]) -> Array:
    q = pin.neutral(model)
    for joint, name in list(zip(model.joints, model.names, strict=True))[1:]:
        if joint.nv == 1:
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                [named[name]] if joint.nq == 1 else [np.cos(named[name]), np.sin(named[name])]
            )
    return np.asarray(q)


def _same(arm: Arm, x: dict[str, float], whole: pin.Model, named: dict[str, float], frames: list[str]) -> bool:
    own, theirs = arm.model.createData(), whole.createData()
    pin.framesForwardKinematics(arm.model, own, _set(arm.model, x))
    pin.framesForwardKinematics(whole, theirs, _set(whole, named))
    for name in frames:
        a = own.oMf[arm.model.getFrameId(name, pin.FrameType.BODY)].homogeneous
        b = theirs.oMf[whole.getFrameId(name, pin.FrameType.BODY)].homogeneous
        if not np.abs(a - b).max() <= _OFF:
            return False
    return True


def _true_of_urdf(said: str, whole: pin.Model, mimics: dict[str, Any], chain: set[str]) -> bool:
    """Whether a refusal states what Pinocchio's own reading of the file bears out."""
    if found := re.search(r"joint '(.+?)' follows joint '(.+?)'", said):
        return found[1] in mimics and bool({found[1], found[2]} & chain)
    if found := re.search(r"joint '(.+?)' follows '(.+?)', which is no moving joint", said):
        return mimics.get(found[1], ("",))[0] == found[2] and not whole.existJointName(found[2])
    if "no moving joint" in said or "no joint moves" in said:
        return bool(whole.nv == 0)
    if found := re.search(r"joint '(.+?)' \(.*\) has \d degrees of freedom", said):
        return bool(whole.joints[whole.getJointId(found[1])].nv > 1)
    if found := re.search(r"joint '(.+?)': position limits .* are empty or reversed", said):
        at = whole.joints[whole.getJointId(found[1])].idx_q
        return not whole.lowerPositionLimit[at] < whole.upperPositionLimit[at]
    return False


# -- MJCF ----------------------------------------------------------------------------------------------------------


def _mjcf(file: Path, rng: np.random.Generator, counts: Counts) -> None:
    import mujoco

    counts.files += 1
    try:
        m = mujoco.MjModel.from_xml_path(str(file))
    except (ValueError, mujoco.FatalError):
        answer = _read(Arm.from_mjcf, file, "tool")
        if not isinstance(answer, str):
            _report(file, counts, "otherwise", "MuJoCo refuses it")
        return
    depth = [0] * m.nbody
    for body in range(1, m.nbody):
        depth[body] = depth[m.body_parentid[body]] + int(m.body_jntnum[body])
    tool = int(np.argmax(depth))
    answer = _read(Arm.from_mjcf, file, m.body(tool).name or f"body_{tool}")
    freedoms = [int(m.jnt_type[j]) for j in range(m.njnt)]
    if isinstance(answer, str):
        true = (
            ("degrees of freedom" in answer and bool({0, 1} & set(freedoms)))
            or (("no moving joint" in answer or "no joint moves" in answer) and m.njnt == 0)
            or ("holds joint" in answer and m.neq > 0)
            or ("follows joint" in answer and m.neq > 0)
            or ("position limits" in answer and not (m.jnt_range[:, 0] < m.jnt_range[:, 1])[m.jnt_limited > 0].all())
        )
        if not true:
            _report(file, counts, "untrue", answer)
        return
    counts.read += 1
    d, model = mujoco.MjData(m), answer.model
    x = dict(zip(list(model.names)[1:], rng.uniform(-1.0, 1.0, model.nv), strict=True))
    for j in range(m.njnt):
        low, high = m.jnt_range[j] if m.jnt_limited[j] else (-np.inf, np.inf)
        d.qpos[m.jnt_qposadr[j]] = x.get(m.joint(j).name or f"joint_{j}", np.clip(0.0, low, high))
    for _ in range(m.neq):  # followers of followers as well
        for e in range(m.neq):
            if m.eq_active0[e] and int(m.eq_type[e]) == int(mujoco.mjtEq.mjEQ_JOINT):
                own, leader = m.jnt_qposadr[m.eq_obj1id[e]], int(m.eq_obj2id[e])
                away = d.qpos[m.jnt_qposadr[leader]] - m.qpos0[m.jnt_qposadr[leader]] if leader >= 0 else 0.0
                d.qpos[own] = m.qpos0[own] + np.polyval(m.eq_data[e][4::-1], away)
    mujoco.mj_kinematics(m, d)
    data = model.createData()
    pin.framesForwardKinematics(model, data, _set(model, x))
    for body in range(1, m.nbody):
        T = data.oMf[model.getFrameId(m.body(body).name or f"body_{body}", pin.FrameType.BODY)]
        off = max(np.abs(T.translation - d.xpos[body]).max(), np.abs(T.rotation.ravel() - d.xmat[body]).max())
        if not off <= _OFF:
            _report(file, counts, "otherwise", f"body {body} is {off:.2g} off")
            return


def _report(file: Path, counts: Counts, which: str, why: str) -> None:
    setattr(counts, which, getattr(counts, which) + 1)
    print(f"{which}: {file.name}: {why[:300]}")
