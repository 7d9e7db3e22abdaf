"""Exports, read by other packages: every position is exact, and no file is partial."""

from __future__ import annotations

import builtins
import csv
import itertools
import tracemalloc
import warnings
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from coopqp import InvalidInputError, Recording, RobotCell
from coopqp.errors import MissingExtraError, OutputError
from coopqp.files import export, write_bag, write_csv
from coopqp.files.export import csv_parts, csv_text, knot_velocities, topic_name
from coopqp.scenarios import Scenario
from coopqp.simulation import SceneError, read_run
from coopqp.simulation.recording import rows
from coopqp.simulation.recording.scene import describe_cell

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from mcap_ros2.reader import read_ros2_messages


@pytest.fixture
def run(baseline: Callable[..., Recording]) -> Recording:
    recording = baseline(40)
    bound = {**recording.metadata, "binding": [[3, [["slave_1", "joint_2", "velocity"]]], [5, []]]}
    return replace(recording, metadata=bound)


@pytest.fixture
def mixed_run(make_cell: Callable[..., RobotCell]) -> tuple[RobotCell, Recording]:
    """A run with a prismatic joint, and a continuous joint that turns beyond π."""
    cell = make_cell(["gantry7", "arm6c"])
    T = 20
    x = np.linspace(0.0, 1.0, T + 1)[:, None] * np.full(cell.nv, 0.2)
    turning = np.flatnonzero(cell.continuous)
    x[:, turning] = np.linspace(3.0, 4.0, T + 1)[:, None]
    q = np.array([cell.configuration(row) for row in x])
    recording = Recording(
        time=np.linspace(0.0, 1.0, T + 1), q=q, q_command=q, velocity=np.diff(x, axis=0) * T,
        clock=np.linspace(0.0, 1.0, T + 1), rate=np.ones(T), status=np.zeros(T),
        reference=np.tile(np.eye(4), (T + 1, 1, 1)), T_object_tool=np.tile(np.eye(4), (2, 1, 1)), notes=(),
        metadata={"scene": describe_cell(cell), "finished": True},
    )  # fmt: skip
    return cell, recording


# -- CSV -----------------------------------------------------------------------------------------------------------


def columns(text: str) -> dict[str, list[str]]:
    rows = list(csv.DictReader(text.splitlines()))
    return {name: [row[name] for row in rows] for name in rows[0]}


def numbers(column: list[str]) -> Any:
    return np.array([float(x) for x in column])


def test_the_table_has_every_digit(run: Recording, paper: Scenario, tmp_path: Path) -> None:
    table = columns(write_csv(run, tmp_path / "new" / "run.csv").read_text())
    assert len(table["time_s"]) == 41
    np.testing.assert_array_equal(numbers(table["time_s"]), run.time)
    np.testing.assert_array_equal(numbers(table["clock_s"]), run.clock)
    for j, name in enumerate(paper.cell.joint_names):
        np.testing.assert_array_equal(numbers(table[f"{name}.position_rad"]), run.q[:, j])
        np.testing.assert_array_equal(numbers(table[f"{name}.command_rad"]), run.q_command[:, j])
        np.testing.assert_array_equal(numbers(table[f"{name}.velocity_rad_per_s"][:-1]), run.velocity[:, j])
    np.testing.assert_array_equal(numbers(table["path.z_m"]), run.reference[:, 2, 3])
    np.testing.assert_array_equal(numbers(table["eps_p_mm"]), read_run(paper.cell, run).eps_p_mm)
    assert set(table["status"][:-1]) == {"tracking"}
    assert [i for i, text in enumerate(table["binding"]) if text] == [3, 4]
    assert table["binding"][3] == "arm slave_1 joint joint_2: velocity"
    assert {table[name][-1] for name in ("rate", "status", "binding", "master/joint_1.velocity_rad_per_s")} == {""}


def test_the_table_has_what_an_operator_called(run: Recording) -> None:
    calls = [[3, "pause", None, 0.2], [7, "reverse", 0.1, 0.2], [7, "jog", [[0.1], "world"], 0.2]]
    called = csv_text(replace(run, metadata={**run.metadata, "calls": calls}))
    table = columns(called)
    assert {i: text for i, text in enumerate(table["call"]) if text} == {
        3: "pause",
        7: 'reverse 0.1; jog [[0.1], "world"]',
    }
    assert {len(row) for row in csv.reader(called.splitlines())} == {len(table)}
    del table["call"]
    assert table == columns(csv_text(run))


def test_the_table_has_the_pose_of_the_path_as_quaternions(run: Recording) -> None:
    table = columns(csv_text(run))
    x, y, z, w = (numbers(table[f"path.q{axis}"]) for axis in "xyzw")
    turned = np.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)], axis=1)
    np.testing.assert_allclose(turned, run.reference[:, :3, 0], atol=1e-12)
    np.testing.assert_array_equal(numbers(table["path.x_m"]), run.reference[:, 0, 3])
    np.testing.assert_array_equal(numbers(table["rate"][:-1]), run.rate)


def test_knot_velocities_of_a_part_are_those_of_the_whole(run: Recording) -> None:
    whole = knot_velocities(run)
    np.testing.assert_array_equal(whole[[0, -1]], 0.0)
    np.testing.assert_allclose(whole[1:-1], 0.5 * (run.velocity[1:] + run.velocity[:-1]), atol=1e-15)
    for part in (slice(0, 1), slice(0, 7), slice(5, 12), slice(30, 41), slice(40, 41), slice(3, None)):
        np.testing.assert_array_equal(knot_velocities(run, part), whole[part])


def test_units_follow_the_joints(mixed_run: tuple[RobotCell, Recording]) -> None:
    cell, recording = mixed_run
    table = columns(csv_text(recording))
    slide = cell.joint_names[0]
    np.testing.assert_array_equal(numbers(table[f"{slide}.position_m"]), recording.q[:, 0])
    assert f"{slide}.velocity_m_per_s" in table
    turning = cell.joint_names[int(np.flatnonzero(cell.continuous)[0])]
    angles = numbers(table[f"{turning}.position_rad"])
    np.testing.assert_allclose(angles, np.linspace(3.0, 4.0, 21))  # without a leap


def test_a_recording_without_a_scene_needs_the_cell(run: Recording, paper: Scenario) -> None:
    bare = replace(run, metadata={"finished": True})
    with pytest.raises(SceneError):
        csv_text(bare)
    assert csv_text(bare, cell=paper.cell).count("\n") == 42
    with pytest.raises(InvalidInputError, match="for a cell with"):
        csv_text(bare, cell=RobotCell(paper.cell.arms[:2]))


# -- ROS 2 bags ----------------------------------------------------------------------------------------------------


def messages(bag: Path) -> dict[str, list[Any]]:
    by_topic: dict[str, list[Any]] = defaultdict(list)
    (file,) = bag.glob("*.mcap")
    for message in read_ros2_messages(str(file)):
        by_topic[message.channel.topic].append(message)
    return by_topic


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec * 10**9 + stamp.nanosec)


def test_a_bag_is_read_back_exactly(run: Recording, paper: Scenario, tmp_path: Path) -> None:
    bag = write_bag(run, tmp_path / "bag")
    topics = messages(bag)
    assert set(topics) == {
        "/joint_states", "/joint_commands", "/object_path",
        *(f"/{arm}/joint_trajectory" for arm in paper.cell.arm_names),
    }  # fmt: skip
    for topic, positions in (("/joint_states", run.q), ("/joint_commands", run.q_command)):
        assert {m.schema.name for m in topics[topic]} == {"sensor_msgs/msg/JointState"}
        states = [m.ros_msg for m in topics[topic]]
        np.testing.assert_array_equal([list(s.position) for s in states], positions)
        np.testing.assert_array_equal([list(s.velocity) for s in states], knot_velocities(run))
        assert all(tuple(s.name) == paper.cell.joint_names and len(s.effort) == 0 for s in states)
        np.testing.assert_allclose([1e-9 * _nanoseconds(s.header.stamp) for s in states], run.time, atol=1e-9)
        assert [_nanoseconds(m.ros_msg.header.stamp) for m in topics[topic]] == [m.log_time_ns for m in topics[topic]]
    poses = [m.ros_msg.pose for m in topics["/object_path"]]
    np.testing.assert_array_equal([[p.position.x, p.position.y, p.position.z] for p in poses], run.reference[:, :3, 3])


def test_an_operators_calls_are_in_the_bag(run: Recording, tmp_path: Path) -> None:
    calls = [[3, "pause", None, 0.2], [7, "reverse", 0.1, 0.2], [7, "jog", [[0.1] * 6, "world", 0.1], 0.2]]
    called = replace(run, metadata={**run.metadata, "calls": calls})
    found = messages(write_bag(called, tmp_path / "bag"))["/operator_calls"]
    assert [m.schema.name for m in found] == ["std_msgs/msg/String"] * 2
    texts = ["pause", 'reverse 0.1; jog [[0.1, 0.1, 0.1, 0.1, 0.1, 0.1], "world", 0.1]']
    assert [m.ros_msg.data for m in found] == texts
    assert [m.log_time_ns for m in found] == [round(1e9 * run.time[i]) for i in (3, 7)]


def test_a_trajectory_is_the_command_of_an_arm(run: Recording, paper: Scenario, tmp_path: Path) -> None:
    topics = messages(write_bag(run, tmp_path / "bag"))
    for arm, own in zip(paper.cell.arm_names, paper.cell.v_slices, strict=True):
        (message,) = topics[f"/{arm}/joint_trajectory"]
        assert message.schema.name == "trajectory_msgs/msg/JointTrajectory"
        trajectory = message.ros_msg
        assert tuple(trajectory.joint_names) == paper.cell.joint_names[own]
        assert _nanoseconds(trajectory.header.stamp) == 0
        np.testing.assert_array_equal([list(p.positions) for p in trajectory.points], run.q_command[:, own])
        times = [_nanoseconds(p.time_from_start) for p in trajectory.points]
        assert times == sorted(set(times))
        assert times[-1] == 3 * 10**9
        for end in (trajectory.points[0], trajectory.points[-1]):
            assert not np.any(end.velocities)


def test_knot_velocities_follow_the_positions(run: Recording) -> None:
    """A cubic through the points passes near the middle of each step's chord, without overshoot."""
    v, h = knot_velocities(run), np.diff(run.time)[:, None]
    middle = 0.5 * (run.q_command[:-1] + run.q_command[1:]) + h / 8.0 * (v[:-1] - v[1:])
    chord = 0.5 * (run.q_command[:-1] + run.q_command[1:])
    steps = np.abs(np.diff(run.q_command, axis=0)).max()
    assert np.abs(middle - chord)[1:-1].max() < 0.05 * steps


def test_a_continuous_joint_does_not_jump_back(mixed_run: tuple[RobotCell, Recording], tmp_path: Path) -> None:
    cell, recording = mixed_run
    topics = messages(write_bag(recording, tmp_path / "bag"))
    arm = cell.arm_names[1]
    (message,) = topics[f"/{topic_name(arm)}/joint_trajectory"]
    j = int(np.flatnonzero(cell.continuous)[0]) - cell.v_slices[1].start
    angles = np.array([p.positions[j] for p in message.ros_msg.points])
    np.testing.assert_allclose(angles, np.linspace(3.0, 4.0, 21), atol=1e-12)
    j += cell.v_slices[1].start
    for topic in ("/joint_states", "/joint_commands"):
        angles = np.array([message.ros_msg.position[j] for message in topics[topic]])
        np.testing.assert_allclose(angles, np.linspace(3.0, 4.0, 21), atol=1e-12)
    turned = replace(recording, metadata={**recording.metadata, "turns": {cell.joint_names[j]: -2}})
    table = columns(csv_text(turned))
    for name in ("position", "command"):  # as a servo that had made two turns back held them
        angles = numbers(table[f"{cell.joint_names[j]}.{name}_rad"])
        np.testing.assert_allclose(angles, np.linspace(3.0, 4.0, 21) - 4.0 * np.pi, atol=1e-12)
    assert np.abs(cell.positions(recording.q)).max() <= np.pi


def test_the_start_of_a_bag_may_be_set(run: Recording, tmp_path: Path) -> None:
    topics = messages(write_bag(run, tmp_path / "bag", start=1_700_000_000.5))
    assert topics["/joint_states"][0].log_time_ns == 1_700_000_000_500_000_000
    assert "bag.mcap" in (tmp_path / "bag" / "metadata.yaml").read_text()
    with pytest.raises(InvalidInputError, match="start is -1"):
        write_bag(run, tmp_path / "other", start=-1.0)


def test_a_bag_is_not_written_over(run: Recording, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(OutputError, match="it exists"):
        write_bag(run, tmp_path / "bag")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        write_bag(run, tmp_path / "file" / "bag")


def test_a_failure_leaves_nothing(run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("coopqp.files.export._rename_inside", full)
    with pytest.raises(OutputError, match="No space left"):
        write_bag(run, tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_rosbags_names_the_extra(run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: Any, **options: Any) -> Any:
        if name.startswith("rosbags"):
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"coopqp\[bags\]"):
        write_bag(run, tmp_path / "bag")


@pytest.mark.parametrize(("arm", "topic"), [("master", "master"), ("arm 1-b", "arm_1_b"), ("7th", "_7th"), ("é", "_")])
def test_topics_have_names_that_ros_allows(arm: str, topic: str) -> None:
    assert topic_name(arm) == topic


def test_the_table_has_the_torques_that_are_fed_forward(paper: Scenario, run: Recording, tmp_path: Path) -> None:
    from coopqp.forces import LoadShare, load_use
    from coopqp.planning import Payload

    payload = Payload(mass=20.0, centre=paper.T_object_body.translation)
    load = LoadShare(paper.cell, paper.grasp, payload, internal_force=50.0)
    use = load_use(load, run.time, run.q_command)
    rows = list(csv.DictReader(write_csv(run, tmp_path / "run.csv", load=use).read_text().splitlines()))
    assert [float(row["master/joint_2.torque_N_m"]) for row in rows] == use.torques[:, 1].tolist()
    assert [float(row["load_share"]) for row in rows] == use.share.tolist()
    plain, more = (text.splitlines()[0] for text in (csv_text(run), csv_text(run, load=use)))
    assert more.startswith(plain + ",")
    with pytest.raises(InvalidInputError, match=r"torques of shape \(5, 18\) for 41 samples of 18 joints.*load_use"):
        csv_text(run, load=load_use(load, run.time[:5], run.q_command[:5]))


# -- long runs -----------------------------------------------------------------------------------------------------


@pytest.fixture
def in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "BLOCK_ROWS", 7)
    monkeypatch.setattr(export, "MAX_TRAJECTORY_STEPS", 6)


def test_a_table_in_parts_is_the_whole_table(run: Recording, tmp_path: Path, in_parts: None) -> None:
    parts = list(csv_parts(run))
    assert [part.count("\n") for part in parts] == [1, *([7] * 5), 6]
    assert (tmp_path / "run.csv").write_text("".join(parts)) == write_csv(run, tmp_path / "other.csv").stat().st_size
    whole = columns("".join(parts))
    np.testing.assert_allclose(numbers(whole["eps_p_mm"]), read_run(run.cell(shapes=False), run).eps_p_mm, atol=1e-12)
    np.testing.assert_array_equal(numbers(whole["path.z_m"]), run.reference[:, 2, 3])


def test_a_long_command_is_several_trajectories(
    mixed_run: tuple[RobotCell, Recording], tmp_path: Path, in_parts: None
) -> None:
    """Each begins where and when the one before ends; together they are the command, with every turn."""
    cell, recording = mixed_run
    topics = messages(write_bag(recording, tmp_path / "bag"))
    arm = topic_name(cell.arm_names[1])
    sent = topics[f"/{arm}/joint_trajectory"]
    assert [len(m.ros_msg.points) for m in sent] == [7, 7, 7, 3]
    np.testing.assert_allclose([1e-9 * m.log_time_ns for m in sent], recording.time[::6], atol=1e-9)
    ends = [(m.ros_msg.points[0], m.ros_msg.points[-1]) for m in sent]
    for (_, end), (begin, _) in itertools.pairwise(ends):
        assert list(begin.positions) == list(end.positions)
        assert list(begin.velocities) == list(end.velocities)
        assert _nanoseconds(begin.time_from_start) == 0
    times = [m.log_time_ns + _nanoseconds(p.time_from_start) for m in sent for p in m.ros_msg.points[1:]]
    np.testing.assert_allclose(1e-9 * np.array(times), recording.time[1:], atol=1e-9)
    j = int(np.flatnonzero(cell.continuous)[0]) - cell.v_slices[1].start
    angles = [ends[0][0].positions[j], *(p.positions[j] for m in sent for p in m.ros_msg.points[1:])]
    np.testing.assert_allclose(angles, np.linspace(3.0, 4.0, 21), atol=1e-12)
    states = topics["/joint_states"]
    np.testing.assert_array_equal([list(m.ros_msg.velocity) for m in states], knot_velocities(recording))


def messages_of(run: Recording, _: Path, *, cell: RobotCell) -> None:
    """All messages of a bag. The writer of rosbags keeps 1 MB of them, more than these runs have."""
    for _message in export.Messages(get_typestore(Stores.ROS2_JAZZY), cell, run, 0.0).all():
        pass


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_csv, messages_of])
def test_memory_does_not_grow_with_the_run(
    write: Callable[..., object], run: Recording, paper: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step is more than 800 bytes of either file; 100 bytes leave room for its limits and for rounding."""
    monkeypatch.setattr(rows, "BLOCK_ROWS", 50)
    monkeypatch.setattr(export, "MAX_TRAJECTORY_STEPS", 50)
    few, largest = 300, []
    for steps in (few, 2 * few):
        again = np.arange(steps + 1) % (run.n_steps + 1)
        samples = {name: getattr(run, name)[again] for name in ("q", "q_command", "clock", "reference")}
        of_steps = {name: getattr(run, name)[again[:-1] % run.n_steps] for name in ("velocity", "rate", "status")}
        long = replace(run, time=0.01 * np.arange(steps + 1), **samples, **of_steps)
        tracemalloc.start()
        write(long, tmp_path / f"{steps}", cell=paper.cell)
        largest.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert largest[1] - largest[0] < 100 * few, largest
