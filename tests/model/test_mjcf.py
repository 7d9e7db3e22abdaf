"""MJCF: read as MuJoCo reads it, over generated files; what depends on more than its own motor is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm
from coopqp.errors import MissingExtraError, ModelError

mujoco = pytest.importorskip("mujoco")


class Generator:
    """Random MJCF files of the features that readers read in several ways."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.count = rng, 0

    def numbers(self, n: int, low: float = -0.3, high: float = 0.3) -> str:
        return " ".join(map(repr, self.rng.uniform(low, high, n).round(4).tolist()))

    def one_of(self, *values: str) -> str:
        return str(self.rng.choice(values))

    def turn(self) -> str:
        """An orientation in one of MuJoCo's ways."""
        kind = self.one_of("quat", "euler", "axisangle", "xyaxes", "zaxis", "")
        size = {"quat": 4, "euler": 3, "axisangle": 4, "xyaxes": 6, "zaxis": 3}.get(kind, 0)
        return f'{kind}="{self.numbers(size, 0.2, 0.9)}"' if kind else ""

    def joint(self, name: str) -> str:
        words = [f'name="{name}"', self.one_of("", 'type="slide"', 'type="hinge"')]
        words.append(self.one_of("", f'axis="{self.numbers(3)}"', 'axis="0 1 0"', 'axis="0 0 -1"'))
        more = (f'pos="{self.numbers(3)}"', f'ref="{self.numbers(1)}"', 'class="other"')
        words += [self.one_of("", text) for text in more]
        ranged = self.one_of("", 'range="-0.8 0.9"', 'range="-0.4 0.3" limited="true"', 'range="-1 1" limited="false"')
        return f"<joint {' '.join(words)} {ranged}/>"

    def body(self, depth: int) -> str:
        self.count += 1
        name = f"b{self.count}"
        inside = [self.joint(f"{name}_j{k}") for k in range(self.rng.choice([0, 1, 1, 1, 2]))]
        inside.append(f'<geom name="{name}_g" size="0.05 0.04 0.03" pos="{self.numbers(3)}" {self.turn()} mass="1"/>')
        if self.rng.random() < 0.5:
            inside.append(f'<geom name="{name}_f" type="capsule" size="0.02" fromto="{self.numbers(6)}"/>')
        inside.append(f'<site name="{name}_s" pos="{self.numbers(3)}" {self.turn()}/>')
        if self.rng.random() < 0.3:
            inside.append(f'<inertial pos="{self.numbers(3)}" mass="2" diaginertia="0.02 0.03 0.04" {self.turn()}/>')
        if depth:
            inside += [self.body(depth - 1) for _ in range(self.rng.integers(1, 3))]
        child = self.one_of("", "", 'childclass="other"')
        words = f'name="{name}" pos="{self.numbers(3)}" {self.turn()} {child}'
        text = f"<body {words}>{''.join(inside)}</body>"
        if self.rng.random() < 0.3:
            text = f'<frame pos="{self.numbers(3)}" {self.turn()}>{text}</frame>'
        return text

    def file(self) -> str:
        compilers = [
            f'<compiler angle="{self.one_of("radian", "degree")}" eulerseq="{self.one_of("xyz", "ZYX", "zxz", "XyZ")}" '
            f'autolimits="true"/>'
            for _ in range(self.rng.integers(1, 3))
        ]
        main = self.one_of("", f'<joint pos="{self.numbers(3)}"/>', '<joint axis="1 0 0" range="-0.5 0.6"/>')
        other = self.one_of("<joint/>", f'<joint ref="{self.numbers(1)}" damping="1"/>', '<joint type="slide"/>')
        default = f'<default>{main}<default class="other">{other}<geom type="box"/></default></default>'
        bodies = "".join(self.body(int(self.rng.integers(1, 4))) for _ in range(self.rng.integers(1, 3)))
        return f"<mujoco>{''.join(compilers)}{default}<worldbody>{bodies}</worldbody></mujoco>"


def at(pos: Any, turn: Any) -> Any:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.asarray(turn).reshape(3, 3), pos
    return T


@pytest.mark.parametrize("files", [30, pytest.param(250, marks=pytest.mark.slow)])
def test_every_file_is_read_as_mujoco_reads_it(
    files: int, tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bodies, sites, shapes, masses, joints and their ranges, by MuJoCo's own kinematics of generated files."""
    file, read = tmp_path / "arm.xml", 0
    monkeypatch.chdir(tmp_path)
    for case in range(files):
        file.write_text(Generator(rng).file())
        m = mujoco.MjModel.from_xml_path(str(file))
        if not m.njnt:
            continue
        moved = [b for b in range(1, m.nbody) if m.body_weldid[b]]
        (tmp_path / "MUJOCO_LOG.TXT").unlink(missing_ok=True)  # from the line above
        arm = Arm.from_mjcf("a", file, tool_frame=m.body(moved[-1]).name, velocity_limits=1.0)
        assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"], "no file of MuJoCo's warnings"
        read += 1
        model, data, d = arm.model, arm.model.createData(), mujoco.MjData(m)
        assert list(model.names)[1:] == [m.joint(j).name for j in range(m.njnt)]
        ranges = np.where(m.jnt_limited[:, None] > 0, m.jnt_range, [-np.inf, np.inf])
        np.testing.assert_allclose(np.column_stack([arm.limits.lower, arm.limits.upper]), ranges, atol=1e-12)
        for q in (np.zeros(m.njnt), rng.uniform(-1.0, 1.0, m.njnt)):
            d.qpos[:] = q
            mujoco.mj_kinematics(m, d)
            mujoco.mj_comPos(m, d)
            mujoco.mj_rne(m, d, 0, bias := np.zeros(m.nv))
            pin.framesForwardKinematics(model, data, q)
            for kind, n, pos, turn in (("body", m.nbody, d.xpos, d.xmat), ("site", m.nsite, d.site_xpos, d.site_xmat)):
                for i in range(kind == "body", n):
                    own = data.oMf[model.getFrameId(getattr(m, kind)(i).name)].homogeneous
                    np.testing.assert_allclose(own, at(pos[i], turn[i]), atol=1e-9, err_msg=f"{case}: {kind} {i}")
            assert arm.collision is not None
            places = arm.collision.createData()
            pin.updateGeometryPlacements(model, data, arm.collision, places)
            for shape, T in zip(arm.collision.geometryObjects, places.oMg, strict=True):
                i = m.geom(shape.name).id
                np.testing.assert_allclose(T.homogeneous, at(d.geom_xpos[i], d.geom_xmat[i]), atol=1e-9)
            np.testing.assert_allclose(pin.computeGeneralizedGravity(model, data, q), bias, atol=1e-9)
    assert read > 0.8 * files


ARM = """<mujoco><compiler angle="radian"/>{head}<worldbody>
<body name="one"><joint name="a"/><geom size="0.1"/>
 <body name="two" pos="0 0 0.3"><joint name="b" axis="0 1 0"/><geom size="0.1"/>
  <body name="hand" pos="0 0 0.3"><joint name="c" axis="1 0 0"/><geom size="0.1"/>
   <body name="left"><joint name="l" type="slide" axis="0 1 0"/><geom size="0.02"/></body>
   <body name="right"><joint name="r" type="slide" axis="0 1 0"/><geom size="0.02"/></body>
  </body></body></body></worldbody><equality>{equality}</equality></mujoco>"""


def test_fingers_that_follow_each_other_stand_together(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(head="", equality='<joint joint1="l" joint2="r" polycoef="0.01 -1 2 0 0"/>'))
    arm = Arm.from_mjcf("a", file, tool_frame="hand", locked_joints={"r": 0.05})
    assert list(arm.model.names)[1:] == ["a", "b", "c"]
    frames = {name: arm.model.frames[arm.model.getFrameId(name)].placement.translation[1] for name in ("left", "right")}
    assert frames == pytest.approx({"right": 0.05, "left": 0.01 - 0.05 + 2 * 0.05**2})
    file.write_text(ARM.format(head="", equality='<joint joint1="l" polycoef="0.03 0 0 0 0"/>'))
    arm = Arm.from_mjcf("a", file, tool_frame="hand")
    assert list(arm.model.names)[1:] == ["a", "b", "c", "r"], "an equality without a second joint holds the first"


@pytest.mark.parametrize(
    ("equality", "says"),
    [
        ('<joint joint1="c" joint2="b" polycoef="0 -1 0 0 0"/>', "joint 'c' follows joint 'b', which moves the tool"),
        (
            '<connect body1="two" anchor="0 0 0"/>',
            r"equality of the bodies 'two' and the world holds joint 'a'.*\(a, b\)",
        ),
        ('<weld body1="hand" body2="one"/>', "equality of the bodies 'hand' and 'one' holds joint 'b'"),
    ],
)
def test_joints_of_the_arm_that_depend_on_each_other_are_refused(tmp_path: Path, equality: str, says: str) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(head="", equality=equality))
    with pytest.raises(ModelError, match=f"arm 'a': .*{says}"):
        Arm.from_mjcf("a", file, tool_frame="hand")
    file.write_text(ARM.format(head="", equality=equality.replace("/>", ' active="false"/>')))
    assert Arm.from_mjcf("a", file, tool_frame="hand").model.nv == 5


def test_meshes_planes_and_groups(tmp_path: Path) -> None:
    """A mesh stands where MuJoCo puts it; a plane is no shape; what may touch nothing is only drawn."""
    (tmp_path / "tetra.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    file = tmp_path / "arm.xml"
    file.write_text(
        '<mujoco><asset><mesh name="t" file="tetra.obj" scale="0.1 0.2 0.3"/></asset><worldbody>'
        '<geom type="plane" size="1 1 1"/><body name="b" pos="0 0 0.5"><joint name="j"/>'
        '<geom name="seen" type="mesh" mesh="t" contype="0" conaffinity="0" rgba="0.1 0.2 0.3 1"/>'
        '<geom name="felt" type="mesh" mesh="t" group="3" pos="0.1 0 0"/></body></worldbody></mujoco>'
    )
    arm = Arm.from_mjcf("a", file, tool_frame="b")
    for shapes, name, x in ((arm.visual, "seen", 0.0), (arm.collision, "felt", 0.1)):
        assert shapes is not None
        (shape,) = shapes.geometryObjects
        assert shape.name == name
        points = np.asarray(shape.geometry.vertices()) @ shape.placement.rotation.T + shape.placement.translation
        found = sorted((points - [x, 0, 0]).round(6).tolist())
        np.testing.assert_allclose(found, [[0, 0, 0], [0, 0, 0.3], [0, 0.2, 0], [0.1, 0, 0]], atol=2e-6)
    assert arm.visual is not None
    assert arm.visual.geometryObjects[0].meshColor == pytest.approx([0.1, 0.2, 0.3, 1.0])
    assert Arm.from_mjcf("a", file, tool_frame="b", geometry=False).collision is None


def test_what_is_no_mjcf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "arm.xml"
    file.write_text('<robot name="r"><link name="a"/></robot>')
    with pytest.raises(ModelError, match=r"arm\.xml is not a readable MJCF \(its root is <robot>, not <mujoco>\)"):
        Arm.from_mjcf("a", file, tool_frame="a")
    file.write_text("<mujoco><worldbody><body><joint/><geom/></body></worldbody></mujoco>")
    with pytest.raises(ModelError, match=r"arm\.xml is not a readable MJCF \(.*size"):
        Arm.from_mjcf("a", file, tool_frame="a")
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[mujoco\]"):
        Arm.from_mjcf("a", file, tool_frame="a")
