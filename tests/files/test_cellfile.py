"""Cell files: the paper's example as a file equals the example in code, and every mistake is named with its place."""

from __future__ import annotations

import builtins
import contextlib
import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from places import CELL_FILES
from ruamel.yaml import YAML

from coopqp import (
    CoopqpError,
    HoldPath,
    PostureOptions,
    PreviewOptions,
    QPOptions,
    Recording,
    RobotCell,
    SupervisionOptions,
    load_cell_file,
)
from coopqp.baselines import IndependentQPOptions, PseudoInverseOptions
from coopqp.checks import meanings
from coopqp.cli.demo import run_method
from coopqp.control import RankWeights
from coopqp.errors import MissingExtraError, UnknownNameError
from coopqp.files import CellFileError
from coopqp.files.cellfile import CELLS, example_path, json_schema, schema_text
from coopqp.files.cellfile.build import CellRun
from coopqp.files.cellfile.hints import grip_hints
from coopqp.files.cellfile.text import read_tables
from coopqp.scenarios import ROBOTS, Scenario, robot_file, robot_path
from coopqp.simulation import PhysicsOptions, PhysicsPlant, Tolerances, read_run
from coopqp.studies import load_study

#: Options of types that a file cannot hold.
NOT_IN_FILES = {(PostureOptions, "target"), (SupervisionOptions, "stiffness")}
EXAMPLES = sorted(CELL_FILES.glob("*.toml"))
PAPER = example_path("paper_lift").read_text()


@pytest.fixture
def load(tmp_path: Path) -> Callable[[str], CellRun]:
    """Write a cell file and load it."""

    def write_and_load(text: str) -> CellRun:
        file = tmp_path / "cell.toml"
        file.write_text(text)
        return load_cell_file(file)

    return write_and_load


def edited(old: str, new: str) -> str:
    """The paper's file with one change."""
    assert old in PAPER
    return PAPER.replace(old, new, 1)


# -- what a file says is what is run -------------------------------------------------------------------------------


def test_the_papers_file_is_the_papers_scenario(paper: Scenario) -> None:
    run = load_cell_file(example_path("paper_lift"))
    ours, theirs = run.scenario, paper
    np.testing.assert_array_equal(ours.q_start, theirs.q_start)
    for a, b in zip(ours.grasp.T_object_tool, theirs.grasp.T_object_tool, strict=True):
        np.testing.assert_array_equal(a.homogeneous, b.homogeneous)
    for a, b in zip(ours.cell.arms, theirs.cell.arms, strict=True):
        assert a.name == b.name
        np.testing.assert_array_equal(a.T_world_base.homogeneous, b.T_world_base.homogeneous)
    for clock in (0.0, 1.3, 3.0):
        np.testing.assert_array_equal(ours.path.pose(clock).homogeneous, theirs.path.pose(clock).homogeneous)
    np.testing.assert_allclose(ours.object_size, theirs.object_size)
    np.testing.assert_allclose(ours.T_object_body.homogeneous, theirs.T_object_body.homogeneous)
    assert (ours.dt, ours.object_mass, ours.name) == (theirs.dt, theirs.object_mass, theirs.name)


#: As the demo runs the QP.
NO_SHORTCUT = 'shortcut = false\nsolver = "daqp"'


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "eps_p_mm"), [("pseudo_inverse", 0.871), ("qp", None)])
def test_the_papers_file_gives_the_figures_of_the_code(
    kind: str, eps_p_mm: float | None, load: Callable[[str], CellRun], paper: Scenario
) -> None:
    run = load(edited('kind = "qp" #', f'kind = "{kind}"\n{NO_SHORTCUT if kind == "qp" else ""} #'))
    recording = run.run()
    figure = float(read_run(run.scenario.cell, recording).eps_p_mm.max())
    assert figure == run_method(paper, kind, 400, solver="daqp").eps_p_mm
    if eps_p_mm is not None:
        assert figure == pytest.approx(eps_p_mm, abs=5e-4)


def test_the_recording_carries_the_file(load: Callable[[str], CellRun], tmp_path: Path) -> None:
    recording = load(edited("steps = 400", "steps = 10")).run()
    again = Recording.load(recording.save(tmp_path / "run.npz"))
    assert again.metadata["scenario"] == "paper_lift"
    assert again.metadata["settings"]["steps"] == 10
    assert again.metadata["settings"]["grasp"] == {"kind": "triangle", "alpha_m": 0.6, "beta_m": 0.3}
    assert again.metadata["object"]["size_m"] == [0.8, 1.8, 0.04]


ONE_ARM = """
name = "one"
[[arms]]
name = "a"
{arm}
[grasp]
kind = "latched"
[path]
{path}
[start]
{start}
"""


def require_robots() -> None:
    try:
        robot_file("panda")
    except MissingExtraError as error:
        pytest.skip(str(error))


def one_arm(
    arm: str = 'robot = "arm7"',
    path: str = 'kind = "hold"\npose = {}\nduration_s = 1.0',
    start: str = "positions_deg.a = [0, 23, 0, 122, 0, -55, 0]",
) -> str:
    return ONE_ARM.format(arm=arm, path=path, start=start)


def test_a_latched_grasp_is_where_the_tools_are(load: Callable[[str], CellRun]) -> None:
    run = load(one_arm(path='kind = "hold"\npose = { xyz_m = [0.5, 0, 0.5] }\nduration_s = 1.0'))
    assert isinstance(run.scenario.path, HoldPath)
    np.testing.assert_allclose(np.rad2deg(run.scenario.q_start), [0, 23, 0, 122, 0, -55, 0])
    recording = run.run()
    assert read_run(run.scenario.cell, recording).object_mm.max() < 1e-9


def test_units_and_limits(load: Callable[[str], CellRun]) -> None:
    """Degrees, radians, and metres for prismatic joints."""
    arm = (
        'robot = "gantry7"\nlimits = { velocity_deg_per_s = [0.9, 90, 90, 90, 90, 90, 90], '
        "acceleration_rad_per_s2 = [2.0, 5, 5, 5, 5, 5, 5], upper_deg = [0.5, 90, 90, 150, 170, 100, 170] }"
    )
    start = "inverse_kinematics = false\npositions_deg.a = [0.25, 0, 45, 90, 0, -45, 0]"
    run = load(one_arm(arm, start=start))
    limits = run.scenario.cell.limits
    np.testing.assert_allclose(limits.velocity, [0.9, *[np.pi / 2] * 6])  # the first joint is prismatic: 0.9 m/s
    np.testing.assert_allclose(limits.acceleration, [2.0, *[5.0] * 6])
    np.testing.assert_allclose(limits.upper, [0.5, *np.deg2rad([90, 90, 150, 170, 100, 170])])
    np.testing.assert_allclose(run.scenario.q_start, [0.25, *np.deg2rad([0, 45, 90, 0, -45, 0])])
    radians = load(one_arm(arm, start="positions_rad.a = [0.25, 0, 0.5, 1.5, 0, -0.8, 0]"))
    np.testing.assert_allclose(radians.scenario.q_start, [0.25, 0, 0.5, 1.5, 0, -0.8, 0])


@pytest.mark.parametrize("limit", ["velocity_deg_per_s = 90", "acceleration_rad_per_s2 = 5", "upper_deg = 90"])
def test_one_number_is_no_limit_of_joints_that_turn_and_joints_that_slide(
    limit: str, load: Callable[[str], CellRun]
) -> None:
    with pytest.raises(CellFileError, match=r"arm 'a': limits.* 'joint_1', which slides .* one number per joint: 7"):
        load(one_arm(f'robot = "gantry7"\nlimits = {{ {limit} }}'))
    load(one_arm('robot = "gantry7"\nlimits = { acceleration_deg_per_s2 = inf }'))


def test_infinite_limits_lift_those_of_the_model(load: Callable[[str], CellRun], tmp_path: Path) -> None:
    run = load(one_arm('robot = "arm7"\nlimits = { velocity_deg_per_s = inf }'))
    assert np.isinf(run.scenario.cell.limits.velocity).all()
    run.run().save(tmp_path / "run.npz")


def test_every_way_to_give_a_placement(load: Callable[[str], CellRun]) -> None:
    bases = (
        "{ xyz_m = [1, 2, 3], rpy_deg = [10, 20, 30] }",
        f"{{ xyz_m = [1, 2, 3], rpy_rad = {np.deg2rad([10, 20, 30]).tolist()} }}",
    )
    expected = pin.SE3(
        pin.utils.rotate("z", np.deg2rad(30))
        @ pin.utils.rotate("y", np.deg2rad(20))
        @ pin.utils.rotate("x", np.deg2rad(10)),
        np.array([1.0, 2.0, 3.0]),
    )
    for base in (*bases, f"{{ matrix = {expected.homogeneous.tolist()} }}"):
        run = load(one_arm(f'robot = "arm7"\nbase = {base}'))
        np.testing.assert_allclose(run.scenario.cell.arms[0].T_world_base.homogeneous, expected.homogeneous, atol=1e-12)


def test_models_from_files_beside_the_cell_file(load: Callable[[str], CellRun], tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "mine.urdf").write_bytes(robot_path("arm7").read_bytes())
    run = load(
        one_arm(
            'urdf = "models/mine.urdf"\ntool_frame = "tool"\nlocked_joints_deg = { joint_7 = 90 }',
            start="positions_deg.a = [0, 23, 0, 122, 0, -55]",
        )
    )
    assert run.scenario.cell.nv == 6
    pytest.importorskip("mujoco")
    mjcf = (
        '<mujoco><worldbody><body name="b"><joint name="j" axis="0 0 1"/><geom size="1"/></body></worldbody></mujoco>'
    )
    (tmp_path / "mine.xml").write_text(mjcf)
    run = load(one_arm('mjcf = "mine.xml"\ntool_frame = "b"', start="positions_deg.a = [30]"))
    assert run.scenario.cell.joint_names == ("a/j",)


def test_a_link_to_a_cell_file_leads_to_the_files_beside_it(load: Callable[[str], CellRun], tmp_path: Path) -> None:
    (tmp_path / "mine.urdf").write_bytes(robot_path("arm7").read_bytes())
    file = Path(str(load(one_arm('urdf = "mine.urdf"\ntool_frame = "tool"')).file))
    link, study = tmp_path / "links" / "today.toml", tmp_path / "study.toml"
    link.parent.mkdir()
    link.symlink_to(file)
    assert load_cell_file(link).scenario.cell.nv == 7
    study.write_text(f'name = "s"\ncell = "{link}"\n[axes]\ndt_s = [0.01, 0.02]\n')
    assert load_study(study).folder == str(tmp_path)


def test_every_form_of_a_path_leads_to_the_model(
    load: Callable[[str], CellRun], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relative to the file, absolute, from home, with variables, in a package; however long."""
    deep = tmp_path.joinpath("mine", *["a long name of a folder " * 3] * 20)
    deep.mkdir(parents=True)
    (deep / "arm.urdf").write_bytes(robot_path("arm7").read_bytes())
    (tmp_path / "mine" / "arm.urdf").write_bytes(robot_path("arm7").read_bytes())
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("MODELS", str(tmp_path / "mine"))
    inner = deep.relative_to(tmp_path)
    for path in (
        f"{inner}/arm.urdf",
        f"{deep}/arm.urdf",
        f"~/{inner}/arm.urdf",
        "$MODELS/arm.urdf",
        "${MODELS}/arm.urdf",
        "package://mine/arm.urdf",
    ):
        assert load(one_arm(f'urdf = "{path}"\ntool_frame = "tool"')).scenario.cell.nv == 7, path
    elsewhere = tmp_path.parent / f"{tmp_path.name} elsewhere" / "theirs"
    elsewhere.mkdir(parents=True)
    (elsewhere / "arm.urdf").write_bytes(robot_path("arm7").read_bytes())
    given = f'package_dirs = ["{elsewhere.parent}"]'
    load(one_arm(f'urdf = "package://theirs/arm.urdf"\ntool_frame = "tool"\n{given}'))
    for path, message in {
        "package://theirs/arm.urdf": "urdf: there is no package 'theirs'. Give the folder above it in package_dirs",
        "$NO_SUCH/arm.urdf": "urdf: the environment variable $NO_SUCH is not set",
        "~nobody_of_that_name/arm.urdf": "urdf: '~nobody_of_that_name' has no home folder",
        "package:///arm.urdf": "there is no package ''",
    }.items():
        with pytest.raises(CellFileError, match=re.escape(message)):
            load(one_arm(f'urdf = "{path}"\ntool_frame = "tool"'))


def test_meshes_are_found_without_help(load: Callable[[str], CellRun], tmp_path: Path) -> None:
    """In the package that the URDF lies in."""
    package = tmp_path / "src" / "my_arm_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    (package / "meshes" / "part.obj").write_text(f"{corners}f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    mesh = '<visual><geometry><mesh filename="package://my_arm_description/meshes/part.obj"/></geometry></visual>'
    limit = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
    (package / "urdf" / "my.urdf").write_text(
        f'<robot name="r"><link name="base">{mesh}</link><link name="tip"/><joint name="j" type="revolute">'
        f'<parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>{limit}</joint></robot>'
    )
    arm = 'urdf = "src/my_arm_description/urdf/my.urdf"\ntool_frame = "tip"'
    visual = load(one_arm(arm, start="positions_deg.a = [3]")).scenario.cell.arms[0].visual
    assert [Path(shape.meshPath).name for shape in visual.geometryObjects] == ["part.obj"]
    (package / "meshes" / "part.obj").unlink()
    with pytest.raises(CellFileError, match=r"Give package_dirs, or geometry = false"):
        load(one_arm(arm, start="positions_deg.a = [3]"))
    run = load(one_arm(f"{arm}\ngeometry = false", start="positions_deg.a = [3]"))
    assert run.scenario.cell.arms[0].visual is None


def test_a_xacro_is_named_with_the_remedy(load: Callable[[str], CellRun], tmp_path: Path) -> None:
    (tmp_path / "arm.urdf.xacro").write_text('<robot name="r" xmlns:xacro="x"/>')
    (tmp_path / "arm.urdf").write_text('<robot name="r"><xacro:include filename="a"/></robot>')
    for name, to in (("arm.urdf.xacro", "arm"), ("arm.urdf", "expanded_arm")):
        with pytest.raises(CellFileError, match=rf"is a xacro.*Expand it .*xacro {name} > {to}\.urdf"):
            load(one_arm(f'urdf = "{name}"\ntool_frame = "tip"'))


def test_a_finger_is_locked_in_metres(load: Callable[[str], CellRun]) -> None:
    """Prismatic joints are in metres under the keys of either unit; a finger that mimics another goes with it."""
    require_robots()
    file = robot_file("panda")
    arm = f'urdf = "{file}"\ntool_frame = "panda_hand_tcp"\ngeometry = false'
    start = "positions_deg.a = [0, -10, 0, -135, 0, 125, 45]"
    assert load(one_arm(arm, start=start)).scenario.cell.nv == 7, "nobody has to lock them"
    places = []
    for unit in ("deg", "rad"):
        for more in ("", ", panda_finger_joint2 = 0.03"):
            lock = f"locked_joints_{unit} = {{ panda_finger_joint1 = 0.03{more} }}"
            model = load(one_arm(f"{arm}\n{lock}", start=start)).scenario.cell.arms[0].model
            places.append(model.frames[model.getFrameId("panda_rightfinger")].placement.translation)
    for other in places[1:]:
        np.testing.assert_array_equal(other, places[0])


def test_a_robot_may_be_named(load: Callable[[str], CellRun]) -> None:
    require_robots()
    arm = 'robot = "panda"\ngeometry = false\nbase = { xyz_m = [0, 0, 1] }'
    cell = load(one_arm(arm, start="positions_deg.a = [0, -10, 0, -135, 0, 125, 45]")).scenario.cell
    assert (cell.nv, cell.arms[0].tool_frame) == (7, "panda_hand_tcp")
    np.testing.assert_array_equal(cell.limits.acceleration, ROBOTS["panda"].acceleration)
    np.testing.assert_array_equal(cell.arms[0].T_world_base.translation, [0, 0, 1])


LINE = """kind = "line"
start = { xyz_m = [0.5, 0, 0.5] }
goal = { xyz_m = [0.5, 0, 0.6], rpy_deg = [0, 0, 90] }
duration_s = 2.0"""
WAYPOINTS = """kind = "waypoints"
poses = [{ xyz_m = [0.5, 0, 0.5] }, { xyz_m = [0.5, 0, 0.6], rpy_deg = [0, 0, 90] }]
durations_s = [2.0]"""


@pytest.mark.parametrize("path", [LINE, WAYPOINTS])
def test_paths(path: str, load: Callable[[str], CellRun]) -> None:
    made = load(one_arm(path=path)).scenario.path
    assert made.duration == 2.0
    np.testing.assert_allclose(made.pose(2.0).translation, [0.5, 0.0, 0.6])
    np.testing.assert_allclose(made.pose(2.0).rotation, pin.utils.rotate("z", np.pi / 2), atol=1e-12)
    assert np.abs(made.twist(0.0)).max() < 1e-12  # quintic by default


def _controller(lines: str) -> str:
    return f"{one_arm(path=LINE)}\n[controller]\n{lines}\n"


@pytest.mark.parametrize(
    ("lines", "kind"),
    [
        ('kind = "qp"', QPOptions),
        ('kind = "pseudo_inverse"', PseudoInverseOptions),
        ('kind = "independent"', IndependentQPOptions),
    ],
)
def test_controllers_have_the_defaults_of_the_code(lines: str, kind: type, load: Callable[[str], CellRun]) -> None:
    options = load(_controller(lines)).options
    defaults = kind()
    assert isinstance(options, kind)
    assert {k: v for k, v in vars(options).items() if isinstance(v, (int, float, str))} == {
        k: v for k, v in vars(defaults).items() if isinstance(v, (int, float, str))
    }


def test_options_reach_the_controller(load: Callable[[str], CellRun]) -> None:
    options = load(
        _controller(
            'kind = "qp"\nsolver = "proxqp"\nsolver_settings = { max_iter = 50 }\ngrasp_gain = 5\n'
            'preview = false\ncommon_error = { kind = "leaderless" }\n'
            "supervision = { stall_samples = false, dt_range = [0.5, 2.0] }\nweights = { posture = 1e-5 }"
        )
    ).options
    assert (options.solver, options.solver_settings.max_iter, options.grasp_gain) == ("proxqp", 50, 5)
    assert options.preview is None
    assert options.common_error.kind == "leaderless"
    assert (options.supervision.stall_samples, options.supervision.dt_range) == (None, (0.5, 2.0))
    assert options.weights.posture == 1e-5
    assert options.weights.chain == QPOptions().weights.chain
    variants = load(_controller('kind = "pseudo_inverse"\nintegration = "midpoint"\nreset_every = 10')).options
    assert (variants.integration, variants.reset_every) == ("midpoint", 10)


@pytest.mark.parametrize(
    "table",
    [
        '{ kind = "leader", leader = "a" }',
        '{ kind = "driver", leader = "a", driver = "a" }',
        '{ kind = "per_axis", weights = [[1, 1, 1, 1, 1, 1]] }',
    ],
)
def test_common_errors(table: str, load: Callable[[str], CellRun]) -> None:
    options = load(_controller(f'kind = "qp"\ncommon_error = {table}')).options
    np.testing.assert_array_equal(options.common_error.shares(_cell(load)), np.ones((1, 6)))


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ('common_error = { kind = "leader", master = "a" }', "common_error: master is no longer a key; give leader"),
        ("weights = { comfort = 1e-5 }", "weights: comfort is no longer a key; give posture"),
        ('common_error = { kind = "master", leader = "a" }', "common_error.kind: .*'master'.*'?leader'?"),
    ],
)
def test_a_name_of_version_01_is_one_error_that_names_the_new_one(
    table: str, says: str, load: Callable[[str], CellRun]
) -> None:
    with pytest.raises(CellFileError, match=says):
        load(_controller(f'kind = "qp"\n{table}'))


def test_the_stiffness_of_servos_is_told_arm_by_arm(load: Callable[[str], CellRun]) -> None:
    def with_stiffness(*values: str) -> str:
        texts = iter([*values, *[""] * 3])
        return re.sub(r'robot = "rx90l"\n', lambda found: f"{found[0]}{next(texts)}\n", PAPER)

    key = "stiffness_nm_per_rad = "
    six = [1e5, 1e5, 5e4, 1e4, 1e4, 5e3]
    run = load(with_stiffness(f"{key}{six}", f"{key}2e4", f"{key}{six}"))
    assert run.options.supervision.stiffness == (*six, *[2e4] * 6, *six)
    np.testing.assert_array_equal(run.stiffness, run.options.supervision.stiffness)
    text = with_stiffness(*[f"{key}2e4"] * 3)
    limited = load(text.replace(QP, f"supervision.force_limit = 200\n{QP}", 1)).options.supervision
    assert (limited.force_limit, limited.stiffness) == (200.0, (2e4,) * 18)
    plain = load(text.replace(QP, 'kind = "pseudo_inverse" #', 1))
    assert plain.stiffness is not None  # for a ForceController
    bare = load(PAPER)
    assert bare.stiffness is None
    assert bare.options.supervision.stiffness is None
    for bad, said in (
        ((f"{key}2e4",), "arm 'slave_1': stiffness_nm_per_rad is missing. .* give it for every arm"),
        ((f"{key}2e4",) * 2 + (f"{key}[1, 2]",), "arm 'slave_2': stiffness_nm_per_rad has 2 numbers for 6 joints"),
        ((f"{key}0",) * 3, r"arms\[0\].stiffness_nm_per_rad: must be from 0.001 to 1e\+09, not 0"),
        ((f"{key}[2e4, -1]",), r"arms\[0\].stiffness_nm_per_rad: must be from .*, not -1"),
        ((f"{key}true",), r"arms\[0\].stiffness_nm_per_rad: give a number or a list"),
    ):
        with pytest.raises(CellFileError, match=said):
            load(with_stiffness(*bad))


def test_arms_of_a_robot_tell_one_stiffness_of_what_they_share(load: Callable[[str], CellRun]) -> None:
    def with_stiffness(*values: str) -> str:
        texts = iter(values)
        return re.sub(r'of = "tower"\n', lambda found: f"{found[0]}stiffness_nm_per_rad = {next(texts)}\n", ROBOT)

    own = [1e5, 1e5, 5e4, 1e4, 1e4, 5e3]
    run = load(with_stiffness(f"{[1e6, *own]}", f"{[1e6, *reversed(own)]}"))
    assert run.stiffness is not None
    np.testing.assert_array_equal(run.stiffness, [1e6, *own, *reversed(own)])
    assert run.options.supervision.stiffness == tuple(run.stiffness)
    with pytest.raises(CellFileError, match=r"arm 'right': .*: 2e\+06 for 'tower/lift', which another arm shares"):
        load(with_stiffness(f"{[1e6, *own]}", f"{[2e6, *own]}"))


def test_who_runs_gripped_arms_in_the_engine_is_asked_for_their_stiffness(load: Callable[[str], CellRun]) -> None:
    engine = f'{PAPER}\n[plant]\nkind = "physics"\n'
    (said,) = grip_hints(load(engine))
    assert "stiffness_nm_per_rad" in said
    told = re.sub(r'(robot = "rx90l")', r"\1\nstiffness_nm_per_rad = 2e4", engine)
    torques = f'{engine}servo = "computed torque"\n'
    for text in (PAPER, told, torques, one_arm(path=LINE) + '[plant]\nkind = "physics"\n'):
        assert grip_hints(load(text)) == []


def test_the_physics_engine_as_the_plant(load: Callable[[str], CellRun]) -> None:
    plant = (
        'kind = "physics"\nstiffness = 2e4\ndamping = false\nsettle = 0.2\ngravity = [0, 0, -1]\nload_shares = [1.0]'
    )
    text = one_arm(path=LINE).replace('name = "one"', 'name = "one"\nsteps = 20', 1)
    run = load(f"{text}\n[plant]\n{plant}\n")
    made = run.plant()
    assert isinstance(made, PhysicsPlant)
    np.testing.assert_array_equal(made.stiffness, 2e4)
    recording = run.run()
    assert recording.finished
    away = np.abs(recording.q - recording.q_command).max()
    assert 1e-9 < away < 0.02  # servos yield a little
    with pytest.raises(CellFileError, match=r"plant: unknown key 'stifness'; did you mean 'stiffness'"):
        load(one_arm(path=LINE) + '[plant]\nkind = "physics"\nstifness = 3\n')
    with pytest.raises(CellFileError, match="plant: there is no 'real'; known: kinematic, physics"):
        load(one_arm(path=LINE) + '[plant]\nkind = "real"\n')


TORQUES = 'kind = "physics"\nservo = "disturbance observer"\nsettle = 0.2\nassumed_mass = 0.5\ntorque_limits = 1e3\n'


@pytest.mark.slow
def test_torque_controlled_drives_as_the_plant(load: Callable[[str], CellRun]) -> None:
    text = one_arm(path=LINE).replace('name = "one"', 'name = "one"\nsteps = 20', 1)
    assert load(f"{text}\n[plant]\n{TORQUES}").run().finished


def test_options_of_torque_controlled_drives_are_read_and_checked(load: Callable[[str], CellRun]) -> None:
    text = one_arm(path=LINE)
    assert load(f"{text}\n[plant]\n{TORQUES}").plant() is not None
    with pytest.raises(CellFileError, match=r"plant: .*observer_bandwidth"):
        load(f"{text}\n[plant]\n{TORQUES}observer_bandwidth = 1000\n").plant()
    with pytest.raises(CellFileError, match=r"servo.*computed torque"):
        load(f'{text}\n[plant]\nkind = "physics"\nservo = "torque"\n')


def _cell(load: Callable[[str], CellRun]) -> RobotCell:
    return load(one_arm()).scenario.cell


# -- mistakes ------------------------------------------------------------------------------------------------------

LEADER = 'name = "master"'
ROBOT, BASE, QP = 'robot = "rx90l"', "xyz_m = [3.60, 0.50, 0.0]", 'kind = "qp" #'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (ROBOT, 'robto = "rx90l"', "arms[0]: unknown key 'robto'; did you mean 'robot'? known: name, robot,"),
        (ROBOT, 'robot = "rx90"', "arms[0].robot: there is no 'rx90'; did you mean 'rx90l'?"),
        (ROBOT, "", "arms[0]: give one of robot, urdf, mjcf"),
        (ROBOT, f'{ROBOT}\nurdf = "a.urdf"', "arms[0]: give one of robot, urdf, mjcf, of, not robot and urdf"),
        (ROBOT, 'urdf = "a.urdf"', "arms[0]: tool_frame is missing"),
        (ROBOT, 'urdf = "a.urdf"\ntool_frame = "tool"', "arm 'master': there is no file"),
        (ROBOT, f'{ROBOT}\ntool_frame = "flnge"', "Did you mean 'flange'?"),
        (
            ROBOT,
            f"{ROBOT}\nlimits = {{ velocity_deg_per_s = [1, 2] }}",
            "velocity_deg_per_s has 2 numbers for 6 joints",
        ),
        (ROBOT, f"{ROBOT}\nlimits = {{ velocity_deg_per_s = -2 }}", "arm 'master': limits: joint 0: velocity"),
        (
            ROBOT,
            f'{ROBOT}\nlimits = {{ velocity_deg_per_s = "a" }}',
            "velocity_deg_per_s: give a number or a list, not 'a'",
        ),
        (
            ROBOT,
            f"{ROBOT}\nlimits = {{ lower_deg = -9, lower_rad = -1 }}",
            "arms[0].limits: give lower_deg or lower_rad, not both",
        ),
        (BASE, "xyz_m = [3.60, 0.50]", "arms[1].base.xyz_m: give at least 3 entries, not 2"),
        (BASE, "xyz_m = [3.60, 0.50, 0.0, 1.0]", "arms[1].base.xyz_m: give at most 3 entries, not 4"),
        (BASE, 'xyz_m = "here"', "arms[1].base.xyz_m: give a list, not 'here'"),
        (BASE, "xyz_m = [3.60, 0.50, nan]", "arms[1].base.xyz_m[2]: must be a finite number, not nan"),
        (BASE, "xyz_m = [3.60, 0.50, true]", "arms[1].base.xyz_m[2]: give a number, not true"),
        ("base = {", "base = 3 #", "arms[1].base: give a table, not 3"),
        ("rpy_deg = [0, 0, 180]", "rpy = [0, 0, 180]", "arms[1].base: unknown key 'rpy'; did you mean 'rpy_"),
        ("rpy_deg = [0, 0, 180]", "matrix = [[1]]", "arms[1].base.matrix[0]: give at least 4 entries, not 1"),
        ('kind = "triangle"', 'kind = "triangel"', "grasp: there is no 'triangel'; did you mean 'triangle'?"),
        ('kind = "triangle"', "", "grasp: kind is missing"),
        ("alpha_m = 0.60", "alpha = 0.60", "grasp: unknown key 'alpha'; did you mean 'alpha_m'?"),
        ("alpha_m = 0.60", "alpha_m = -1", "grasp.alpha_m: must be greater than or equal to 0.0001, not -1"),
        ("alpha_m = 0.60", 'alpha_m = "0.6"', "grasp.alpha_m: give a number, not '0.6'"),
        ("alpha_m = 0.60", "", "grasp.alpha_m: is missing"),
        ("duration_s = 3.0", "duration_s = 0", "path.duration_s: must be greater than or equal to 0.000001, not 0"),
        ("displacement", "goal = {}\ndisplacement", "path: give one of goal, displacement, not goal and displacement"),
        ('"linear"', '"cubic"', "path.time_law: there is no 'cubic'; known: quintic, linear"),
        ("steps = 400", "steps = 400\ndt_s = 0.1", "give dt_s or steps, not both"),
        ("steps = 400", "steps = 400.5", "steps: give a whole number, not 400.5"),
        ("steps = 400", "steps = 100000000", "steps: must be less than or equal to 1000000"),
        ("steps = 400", "dt_s = 1e-9", "dt_s: must be greater than or equal to 0.000001, not 1e-09"),
        ("steps = 400", "dt_s = 2e-6", "in steps of 2e-06 s is too long"),
        ("positions_deg.slave_2", "positions_deg.slave_3", "no arm named 'slave_3' in start.positions_deg"),
        ("positions_deg.slave_2", "#", "start.positions_deg: arm 'slave_2' is missing"),
        ("[-13.8, 67.4", "[67.4", "start.positions_deg.slave_2 has 5 numbers for 6 joints"),
        (QP, 'kind = "pq" #', "controller: there is no 'pq'; known: qp, pseudo_inverse, independent"),
        (QP, f"grasp_gian = 3\n{QP}", "controller: unknown key 'grasp_gian'; did you mean 'grasp_gain'?"),
        (
            QP,
            f'kernel = "plain"\n{QP}',
            "controller: kernel is no longer a key; leave it out: the core makes every step",
        ),
        (QP, f"iterations = 2\n{QP}", "controller: iterations is no longer a key; leave it out: long steps are"),
        (QP, f"grasp_gain = -3\n{QP}", "grasp_gain: -3 is outside"),
        (QP, f'solver = "proxpq"\n{QP}', "no QP solver named 'proxpq'. Did you mean 'proxqp'?"),
        (QP, f"solver_settings = {{ eps = 3 }}\n{QP}", "no setting named 'eps' in "),
        (QP, f"preview = {{ cel = 3 }}\n{QP}", "controller.preview: unknown key 'cel'; did you mean 'cell'?"),
        (QP, f"preview = true\n{QP}", "controller.preview: give a table or false, not true"),
        (
            QP,
            f'common_error = {{ kind = "driver" }}\n{QP}',
            "controller.common_error: kind 'driver' takes driver and leader",
        ),
        (QP, f'common_error = {{ kind = "leader", leader = "me" }}\n{QP}', "no arm named 'me'"),
        ("[output]", "[outptu]", "the file: unknown key 'outptu'; did you mean 'output'?"),
        ('"slave_2"', '"slave_1"', "two arms are named 'slave_1'"),
        ('"slave_2"', '"a/b"', "'a/b' is not a name"),
        ("[0.90, 0.0, 0.10]", "[0.90, 0.0, 3.10]", "arm 'master' does not reach its grasp"),
        ("[grasp]", "[grasp", "is not TOML"),
        ('name = "paper_lift"', "name = 3", "name: give text, not 3"),
        ('name = "paper_lift"', "name = 2024-01-02", "name: give text, not 2024-01-02"),
        ("mass_kg = 20.0", "mass_kg = 1e300", "object.mass_kg: must be less than or equal to 1000000, not 1e+300"),
        ("[0.80, 1.80, 0.04]", "[0.80, 1.80, 1e-300]", "object.size_m[2]: must be greater than or equal to 0.0001"),
        (BASE, "xyz_m = [3.60, 0.50, 1e308]", "arms[1].base.xyz_m[2]: must be less than or equal to 10000"),
        ("[0.90, 0.0, 0.10]", "[0.90, -1e308, 0.10]", "path.start.xyz_m[1]: must be greater than or equal to -10000"),
        (QP, f"grasp_gain = 1e300\n{QP}", "controller.grasp_gain: must be less than or equal to 1000000000000"),
        (
            LEADER,
            f"{LEADER}\nsensor.bias_force_n = [1, 2]",
            "arms[0].sensor.bias_force_n: give at least 3 entries, not 2",
        ),
        (LEADER, f"{LEADER}\nsensor.bias_force_n = [1, 2, 3, 4]", "bias_force_n: give at most 3 entries, not 4"),
        (LEADER, f"{LEADER}\nsensor.axes = [[1, 0, 0], [0, 1, 0]]", "arms[0].sensor.axes: give at least 3 entries"),
        (
            LEADER,
            f"{LEADER}\nsensor.axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1.5]]",
            "axes[2][2]: must be less than or equal",
        ),
        (LEADER, f"{LEADER}\nsensor.axes = [[1, 0, 0], [0, 1, 0], [0, 0, -1.5]]", "axes[2][2]: must be greater than"),
        (
            LEADER,
            f"{LEADER}\nsensor.delay_s = -1",
            "arms[0].sensor.delay_s: must be greater than or equal to 0, not -1",
        ),
        (LEADER, f'{LEADER}\nsensor.reads = "me"', "'me'"),
        (
            "[grasp]",
            "[disturbances]\nwrench_noise_n = 1\n[grasp]",
            "disturbances: only the plant physics simulates them",
        ),
        ("steps = 400", "dt_s = 2.9999e-6", "a run of up to 30 s in steps of 2.9999e-06 s is too long"),
        (
            "steps = 400",
            "dt_s = 0.1\nlongest_s = 1e5\nsettle_s = 1e5\n[signals_s]\na = 1e6\n",
            "signals_s.a: must be less than or equal to 100000",
        ),
        (
            "duration_s = 3.0",
            "duration_s = { a = [1, 2], b = { c = { d = { e = { f = 1 } } } } }",
            "path.duration_s: give a number, not a table",
        ),
        ("duration_s = 3.0", "duration_s = 12:30:00", "path.duration_s: give a number, not 12:30:00"),
        ("[output]", '[output]\nfolder = "../up"', "output.folder: give a folder below the working directory"),
        ("[output]", '[output]\nfolder = "/up"', "output.folder: give a folder below the working directory"),
        (
            "[output]",
            f"[output]\nfolder = {list(range(70))}",
            f"output.folder: give text, not {str(list(range(70)))[:40]}",
        ),
        ("translation_m = [", "translation_mm = [", "path.displacement: unknown key 'translation_mm'; did you mean"),
        (QP, f'preview = {{ cells = "x" }}\n{QP}', "controller.preview: unknown key 'cells'; did you mean 'cell'?"),
        (QP, f"supervision = {{ slow_from = true }}\n{QP}", "supervision.slow_from: give a number or false, not true"),
        (QP, f'common_error = {{ kind = "leaderless", leader = "master" }}\n{QP}', "'leaderless' takes nothing else"),
        (QP, f'common_error = {{ kind = "per_axis", weights = [[1, 1]] }}\n{QP}', "give at least 6 entries, not 2"),
        (
            "positions_deg.slave_2",
            "positions_rad.slave_2",
            "start: give positions_deg or positions_rad, not both",
        ),
        ("steps = 400", "settle_s = -1", "settle_s: must be greater than or equal to 0, not -1"),
        ("steps = 400", "patience_s = 0", "patience_s: must be greater than or equal to 0.000001, not 0"),
        ("[output]", "[output]\nplots = 1", "output.plots: give true or false, not 1"),
        (QP, f"solver_settings = {{ eps_abs = [1] }}\n{QP}", "controller.solver_settings.eps_abs: give"),
        ('kind = "triangle"', 'kind = "latched" #', "grasp: unknown key 'alpha_m'"),
        ('"master"', '""', "arms[0].name: give at least 1 character, not ''"),
        ('"master"', f'"{"m" * 101}"', "arms[0].name: give at most 100 characters, not 'mmm"),
    ],
)
def test_a_mistake_is_named_with_its_place(
    old: str, new: str, message: str, load: Callable[[str], CellRun], tmp_path: Path
) -> None:
    with pytest.raises(CellFileError) as caught:
        load(edited(old, new))
    assert str(caught.value).startswith(str(tmp_path / "cell.toml"))
    assert message in str(caught.value)


def test_many_mistakes_are_listed_up_to_a_few(load: Callable[[str], CellRun]) -> None:
    broken = PAPER
    for key in ("alpha_m", "beta_m", "duration_s", "kind", "mass_kg", "size_m", "time_law"):
        broken = broken.replace(f"{key} = ", f"{key}x = ")
    with pytest.raises(CellFileError, match=r"grasp: kind is missing; path: kind is missing; object: unknown key"):
        load(broken)
    many = edited("steps = 400", "\n".join(f"{key} = true" for key in ("settle_s", "longest_s", "dt_s"))).replace(
        "name =", "name = 3 #"
    )
    with pytest.raises(CellFileError, match=r"and \d more"):
        load(many)


@pytest.mark.parametrize("content", [b"\xff\xfe", b"", b"a = 1", b"[" * 5000, b"[[arms]]\n" * 3, b"x = " + b"[" * 3000])
def test_what_is_no_cell_file_is_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_bytes(content)
    with pytest.raises(CellFileError):
        load_cell_file(file)


@settings(max_examples=max(1, settings().max_examples // 2))
@given(data=st.data())
def test_whatever_is_broken_in_a_file_ends_in_its_error(data: st.DataObject, tmp_path_factory: Any) -> None:
    """With lines dropped, doubled and swapped, and values replaced, the result is a run or a CellFileError."""
    lines = PAPER.splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        i = data.draw(st.integers(0, len(lines) - 1))
        key, equals, _ = lines[i].partition("=")
        values = ("-1", "0", "1e300", "nan", "-inf", '""', "[]", "{}", "true", "2026-01-01", "[[[]]]", '"é\\u0000"')
        change = data.draw(st.sampled_from(("drop", "double", "move", *values)))
        if change in values:
            lines[i] = f"{key}{equals} {change}" if equals else f"[{change}]"
        else:
            line = lines[i] if change == "double" else lines.pop(i)
            if change != "drop":
                lines.insert(data.draw(st.integers(0, len(lines))), line)
    file = tmp_path_factory.mktemp("broken") / "cell.toml"
    file.write_text("\n".join(lines), encoding="utf-8")
    with contextlib.suppress(CellFileError):
        load_cell_file(file)


YAML_REFUSED = {
    "name: 1\nname: 2": "line 2 is not YAML: .*duplicate key",
    "a: &x [1]\nb: *x": r"line 2 has the alias \*x",
    "a: !!python/object/apply:os.getcwd []": "could not determine a constructor",
    "a: !own 1": "could not determine a constructor",
    "[" * 3000: "nested more than 50 deep",
    "a: [": "line 1 is not YAML",
    "a: 1\n---\nb: 2": "another document",
    "x: " + "9" * 6000: "not YAML: Exceeds the limit",
    "? [1]\n: 2": "unknown key",
    "": "the file: give a table, not null",
    "- 1": r"the file: give a table, not \[1\]",
}


@pytest.mark.parametrize("text", YAML_REFUSED)
def test_what_is_no_yaml_cell_file_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    with pytest.raises(CellFileError, match=YAML_REFUSED[text]) as caught:
        load_cell_file(file)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(file))


@pytest.mark.slow
def test_a_yaml_file_says_what_the_toml_file_says(tmp_path: Path) -> None:
    file = tmp_path / "cell.yml"
    for example in EXAMPLES:
        tables = read_tables(example)
        (tmp_path / example.name).write_text(example.read_text())
        with file.open("w") as stream:
            YAML(typ="safe", pure=True).dump(tables, stream)
        assert read_tables(file) == tables
        run, same = load_cell_file(tmp_path / example.name), load_cell_file(file)
        assert run.settings == same.settings
    file.write_text("dt_s: 1e-3")
    assert read_tables(file) == {"dt_s": 1e-3}  # as in YAML 1.2; a text for readers of 1.1


def test_missing_and_huge_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CellFileError, match="No such file"):
        load_cell_file(tmp_path / "none.toml")
    with pytest.raises(CellFileError, match="cannot read"):
        load_cell_file(tmp_path)
    huge = tmp_path / "huge.toml"
    huge.write_bytes(b"#" * 1_000_001)
    with pytest.raises(CellFileError, match="larger than 1000000 bytes"):
        load_cell_file(huge)
    huge.rename(tmp_path / "huge.yaml")
    with pytest.raises(CellFileError, match="larger than 100000 bytes"):
        load_cell_file(tmp_path / "huge.yaml")


def test_an_unknown_example_is_named() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'paper_lift'"):
        example_path("paper_lfit")


def test_a_missing_pydantic_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coopqp.files.cellfile.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[files\]"):
        schema_text()


# -- the schema ----------------------------------------------------------------------------------------------------


def test_the_schema_explains_every_key_of_the_examples() -> None:
    text = schema_text()
    for key in (
        "[[arms]]",
        "tool_frame",
        "velocity_deg_per_s",
        'kind = "triangle"',
        "rotation_vector_deg",
        "grasp_gain",
    ):
        assert key in text
    assert "number or false" in text
    assert "``" not in text
    assert max(map(len, text.splitlines())) <= 130


def test_every_key_has_a_meaning() -> None:
    """Editors show the meanings in the JSON schema."""
    schema = json_schema()
    json.dumps(schema)
    for name, table in schema["$defs"].items():
        for key, value in table.get("properties", {}).items():
            assert key == "kind" or value.get("description"), f"{name}.{key}"


def test_options_have_their_meaning_in_one_place_and_say_it_everywhere() -> None:
    """``help()`` and the files take it from there; no docstring is read."""
    text = " ".join(schema_text().split())
    for options in (
        QPOptions, PseudoInverseOptions, IndependentQPOptions, PhysicsOptions, Tolerances, RankWeights,
        SupervisionOptions, PreviewOptions, PostureOptions,
    ):  # fmt: skip
        said = meanings(options)
        assert set(said) == {field.name for field in dataclasses.fields(options)}, options
        for name, meaning in said.items():
            assert f"{name}: {meaning}." in str(options.__doc__)
            assert "``" not in meaning
            assert meaning.replace("None", "false") in text or (options, name) in NOT_IN_FILES, name


def test_numbers_that_may_be_off_are_said_in_words() -> None:
    text = schema_text()
    assert '"False"' not in text
    assert re.search(r"stiffness +number or list of numbers or false", text)


def test_the_files_that_ship_are_listed() -> None:
    folder = example_path(CELLS[0]).parent
    assert {file.stem for file in folder.glob("*.toml")} == set(CELLS)


def test_reading_a_file_imports_and_runs_nothing_else(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Names in a file are looked up in tables and never reach the import system."""
    real, asked = builtins.__import__, []

    def spy(name: str, *arguments: Any, **options: Any) -> Any:
        asked.append(name)
        return real(name, *arguments, **options)

    load_cell_file(example_path("paper_lift"))
    monkeypatch.setattr(builtins, "__import__", spy)
    file = tmp_path / "cell.toml"
    file.write_text(edited(QP, f'solver = "os; import this"\n{QP}'))
    with pytest.raises(CoopqpError):
        load_cell_file(file)
    assert not [name for name in asked if "this" in name or "os;" in name]


def test_a_start_that_the_run_refuses_is_told_in_the_words_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    ball = '[[collision.obstacles]]\nname = "ball"\nshape = "sphere"\nradius_m = 0.1\nat.xyz_m = [%g, %g, %g]\n'
    at = load_cell_file(example_path("paper_lift")).scenario.path.pose(0.0).translation
    file.write_text(example_path("paper_lift").read_text(encoding="utf-8") + ball % tuple(at), encoding="utf-8")
    with pytest.raises(
        CellFileError, match=r"cell\.toml: start: .*ball overlap.*collision\.margins.*collision\.inside"
    ):
        load_cell_file(file).run()


ROBOT = """
name = "lift"
[[robots]]
name = "tower"
robot = "lift2"
locked_joints_deg = {}
limits."*" = { acceleration_deg_per_s2 = 300 }
limits.lift = { acceleration_rad_per_s2 = 0.5, velocity_rad_per_s = 0.08 }
[[arms]]
name = "left"
of = "tower"
tool_frame = "left_tool"
[[arms]]
name = "right"
of = "tower"
tool_frame = "right_tool"
[grasp]
kind = "tools"
tools.left = { xyz_m = [0.0, 0.30, 0.0], rpy_deg = [90, 0, 0] }
tools.right = { xyz_m = [0.0, -0.30, 0.0], rpy_deg = [-90, 0, 0] }
[path]
kind = "line"
start = { xyz_m = [0.55, 0.0, 0.80] }
displacement = { translation_m = [0.0, 0.0, 0.05] }
duration_s = 0.5
"""


def test_a_robot_with_two_arms(tmp_path: Path) -> None:
    """Limits by joint, and a start whose shared joints go by the robot's name."""
    file = tmp_path / "cell.toml"
    file.write_text(ROBOT)
    run = load_cell_file(file)
    cell = run.scenario.cell
    assert cell.joint_names[:2] == ("tower/lift", "left/left_joint_1")
    assert cell.limits.velocity[0] == 0.08
    np.testing.assert_allclose(cell.limits.acceleration, [0.5, *[np.deg2rad(300.0)] * 12])
    x = np.rad2deg(cell.positions(run.scenario.q_start))
    given = {name: x[own].tolist() for name, own in cell.blocks.items()}
    given["tower"] = [0.15]
    rows = "".join(f"positions_deg.{name} = {values}\n" for name, values in given.items())
    file.write_text(f"{ROBOT}[start]\ninverse_kinematics = false\n{rows}")
    assert load_cell_file(file).scenario.cell.positions(load_cell_file(file).scenario.q_start)[0] == 0.15


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'of = "tower"\ntool_frame = "left_tool"',
            'of = "tow"\ntool_frame = "left_tool"',
            "is of 'tow', and there is no",
        ),
        ('of = "tower"\ntool_frame = "left_tool"', 'of = "tower"', "tool_frame is missing"),
        (
            'of = "tower"\ntool_frame = "left_tool"',
            'of = "tower"\ntool_frame = "left_tool"\nbase = {}',
            "base is the robot's",
        ),
        ("limits.lift", "limits.lifts", "the model has no joint 'lifts'"),
        (
            'limits."*" = { acceleration_deg_per_s2 = 300 }\nlimits.lift = {',
            "limits = {",
            "robots[0].limits: limits of a robot are by joint",
        ),
        (
            'of = "tower"\n',
            'of = "tower"\nstiffness_nm_per_rad = 1e4\n',
            "one number would be for joints that turn and for 'lift', which slides",
        ),
        (
            'robot = "lift2"',
            'robot = "lift2"\nurdf = "a.urdf"',
            "robots[0]: give one of robot, urdf, not robot and urdf",
        ),
    ],
)
def test_wrong_robots_are_named(old: str, new: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    assert old in ROBOT
    file.write_text(ROBOT.replace(old, new))
    with pytest.raises(CellFileError) as caught:
        load_cell_file(file)
    assert message in str(caught.value)
