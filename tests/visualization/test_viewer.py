"""The 3D scene, live and as a page: poses and marks at a sample, and the contents of the page."""

from __future__ import annotations

import builtins
import contextlib
import http.client
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm, CollisionScene, InvalidInputError, Recording, RobotCell, Status
from coopqp.collision import Body, Box, Capsule, Cylinder, Hull, Sphere
from coopqp.errors import MissingExtraError, OutputError
from coopqp.scenarios import Scenario, robot_path
from coopqp.simulation import SceneError, describe_object, tool_placements
from coopqp.simulation.evaluation.closeness import with_clearance
from coopqp.simulation.recording.bodies import read_bodies
from coopqp.simulation.recording.scene import describe_cell
from coopqp.visualization import LiveViewer, export_html, viewer
from coopqp.visualization.run_panel import RunPanel
from coopqp.visualization.run_view import ALERT, FIELD_OF_VIEW, Stage


class Node:
    """Replaces a node of viser's scene and stores its attributes."""

    def __init__(self, **options: Any) -> None:
        self.__dict__.update(options)


class FakeScene:
    """Replaces viser's scene and stores the nodes by name."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}

    def __getattr__(self, method: str) -> Callable[..., Node]:
        assert method.startswith("add_")

        def add(name: str, *arguments: Any, **options: Any) -> Node:
            assert name not in self.nodes
            self.nodes[name] = Node(arguments=arguments, text=arguments[0] if arguments else None, **options)
            return self.nodes[name]

        return add


@pytest.fixture
def run(baseline: Callable[..., Recording], paper: Scenario) -> Recording:
    """A run with joint 3 of slave 2 at its speed limit in steps 10 to 19."""
    recording = baseline(40)
    extra = {
        "binding": [[10, [["slave_2", "joint_3", "velocity"]]], [20, []], [30, [["", "", "path end"]]]],
        "object": describe_object(paper.object_size, paper.T_object_body),
        "scenario": "paper_lift",
    }
    return replace(recording, metadata={**recording.metadata, **extra})


@pytest.fixture
def scene() -> FakeScene:
    return FakeScene()


def said(stage: Stage, sample: int) -> str:
    """The words of the panel at a sample."""
    moment = RunPanel(stage.cell, stage.recording, stage.readings).moment(sample)
    return f"{moment.clock} · {moment.status.value} · {moment.why} · {', '.join(moment.values)}"


def _pose(node: Node) -> pin.SE3:
    w, x, y, z = node.wxyz
    return pin.SE3(pin.Quaternion(float(w), float(x), float(y), float(z)).matrix(), np.asarray(node.position))


def test_links_and_object_stand_where_the_run_says(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    stage = Stage(scene, run)
    data = paper.cell.model.createData()
    for sample in (0, 17, 40):
        stage.show(sample)
        pin.forwardKinematics(paper.cell.model, data, run.q[sample])
        for j in range(1, 19):
            np.testing.assert_allclose(
                _pose(scene.nodes[f"/links/{j}"]).homogeneous, data.oMi[j].homogeneous, atol=1e-9
            )
        tool = tool_placements(paper.cell, [run.q[sample]])[0][0]
        carried = tool * paper.grasp.T_object_tool[0].inverse()
        np.testing.assert_allclose(_pose(scene.nodes["/object"]).homogeneous, carried.homogeneous, atol=1e-9)


def test_names_stay_above_their_arms(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    """At every sample the name is straight above the highest joint or tool, by less than half a metre."""
    stage = Stage(scene, run)
    data = paper.cell.model.createData()
    for sample in (0, 20, 40):
        stage.show(sample)
        pin.framesForwardKinematics(paper.cell.model, data, run.q[sample])
        for arm, own in enumerate(paper.cell.v_slices):
            points = [data.oMi[j + 1].translation for j in range(own.start, own.stop)]
            points.append(data.oMf[paper.cell.tool_frames[arm]].translation)
            highest = max(points, key=lambda point: float(point[2]))
            place = np.asarray(scene.nodes[f"/names/{paper.cell.arm_names[arm]}"].position)
            np.testing.assert_allclose(place[:2], highest[:2], atol=1e-9)
            assert 0.02 < place[2] - highest[2] < 0.5


def test_every_shape_is_there(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    Stage(scene, run)
    drawn = [name for name in scene.nodes if name.startswith("/links/") and name.count("/") == 3]
    assert len(drawn) == paper.cell.visual_model().ngeoms
    corners = scene.nodes["/object/body"].arguments[0]
    np.testing.assert_allclose(np.ptp(corners, axis=0), paper.object_size, atol=1e-6)
    assert {f"/object/grasp {name}" for name in paper.cell.arm_names} <= set(scene.nodes)
    np.testing.assert_allclose(
        scene.nodes["/path/line 0"].arguments[0][0, 0], paper.path.pose(0).translation, atol=1e-6
    )
    assert not any(name.startswith("/sticks/") for name in scene.nodes)


def _colours(scene: FakeScene, joint: int) -> set[tuple[int, int, int]]:
    return {node.color for name, node in scene.nodes.items() if name.startswith(f"/links/{joint}/")}


def test_a_limit_that_binds_is_marked_and_named(scene: FakeScene, run: Recording) -> None:
    stage = Stage(scene, run)
    plain = {j: _colours(scene, j) for j in range(1, 19)}
    stage.show(15)
    assert _colours(scene, 15) == {ALERT}  # joint 3 of slave 2
    for j in (13, 14, 16, 17, 18):
        assert _colours(scene, j) != plain[j]
    assert all(_colours(scene, j) == plain[j] for j in range(1, 13))
    assert scene.nodes["/names/slave_2"].text == "slave 2\n! joint 3 velocity"
    assert "full speed; joint 3 of slave 2 is at its largest speed." in said(stage, 15)
    for sample in (25, 35):
        stage.show(sample)
        assert all(_colours(scene, j) == plain[j] for j in range(1, 19))
        assert scene.nodes["/names/slave_2"].text == "slave 2"
        assert ("no limit binds" if sample == 25 else "the path ends") in said(stage, sample)


def test_what_binds_is_told_whatever_it_is(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    """Distances and constraints, too; without a limit the run's own words for a step that does not track."""
    recording, _ = _surrounded(run, paper)
    near = ["", "", "collision", "", ["slave_1/forearm_link", "post"]]
    bound = [[10, [near]], [20, [["", "", "constraint", "my_torques"]]], [30, []]]
    status = recording.status.copy()
    status[10:] = Status.BLOCKED.code
    notes = ("10: The object is stopped.", "30: The arms wait for no reason.")
    recording = replace(recording, status=status, notes=notes, metadata={**recording.metadata, "binding": bound})
    stage = Stage(scene, recording)
    names = [name for name, _, _ in read_bodies(recording.metadata)]
    post = scene.nodes[f"/bodies/{names.index('post')}"]
    plain = post.color
    stage.show(15)
    assert "slave 1/forearm link and post are as near as they may be" in said(stage, 15)
    assert post.color != plain
    assert scene.nodes["/names/slave_1"].text == "slave 1\n! forearm link near post"
    assert scene.nodes["/names/slave_2"].text == "slave 2"
    stage.show(25)
    assert post.color == plain
    assert "the constraint my_torques binds" in said(stage, 25)
    assert "The arms wait for no reason." in said(stage, 35)


def test_the_last_sample_shows_the_last_step(scene: FakeScene, run: Recording) -> None:
    bound = {**run.metadata, "binding": [[39, [["master", "", "singularity"]]]]}
    stage = Stage(scene, replace(run, metadata=bound))
    stage.show(40)
    assert scene.nodes["/names/master"].text == "master\n! singularity"
    assert said(stage, 40).startswith("t = 3.00 s · 100 % of the path · tracking · ")


def test_the_goal_is_shown_even_if_it_was_not_reached(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    half = replace(
        run, time=run.time[:21], q=run.q[:21], q_command=run.q_command[:21], velocity=run.velocity[:20],
        clock=run.clock[:21], rate=run.rate[:20], status=run.status[:20], reference=run.reference[:21],
    )  # fmt: skip
    Stage(scene, half)
    goal = paper.path.pose(3.0) * paper.T_object_body
    np.testing.assert_allclose(scene.nodes["/path/end"].arguments[0].mean(axis=(0, 1)), goal.translation, atol=1e-6)
    unknown = FakeScene()
    Stage(unknown, replace(half, metadata={**half.metadata, "path": None}))
    reached = pin.SE3(half.reference[-1]) * paper.T_object_body
    np.testing.assert_allclose(
        unknown.nodes["/path/end"].arguments[0].mean(axis=(0, 1)), reached.translation, atol=1e-6
    )


def test_a_path_without_end_has_no_share(scene: FakeScene, run: Recording) -> None:
    endless = replace(run, metadata={**run.metadata, "duration": float("inf")})
    assert said(Stage(scene, endless), 40).startswith("t = 3.00 s · tracking · ")


def test_sticks_join_base_joints_and_tool(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    stage = Stage(scene, run, sticks=True)
    stage.show(40)
    for k, (name, arm) in enumerate(zip(paper.cell.arm_names, paper.cell.arms, strict=True)):
        points = scene.nodes[f"/sticks/{name}"].points
        assert points.shape == (7, 2, 3)
        np.testing.assert_allclose(points[0, 0], arm.T_world_base.translation, atol=1e-6)
        np.testing.assert_allclose(points[-1, 1], tool_placements(paper.cell, [run.q[40]])[0][k].translation, atol=1e-6)
        np.testing.assert_allclose(points[1:, 0], points[:-1, 1], atol=1e-6)  # one chain
    stage.show(15)
    assert tuple(scene.nodes["/sticks/slave_2"].colors[2, 0]) == ALERT
    assert not hasattr(scene.nodes["/sticks/master"].colors, "shape")


def test_arms_without_shapes_become_sticks(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    bare = RobotCell([replace(arm, visual=None) for arm in paper.cell.arms])
    Stage(scene, replace(run, metadata={**run.metadata, "scene": describe_cell(bare)}))
    assert {f"/sticks/{name}" for name in bare.arm_names} <= set(scene.nodes)


def test_everything_is_in_view(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    """Bases, tools and object are in the visible part of a 4:3 window."""
    stage = Stage(scene, run)
    eye, target = stage.camera()
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    points = [arm.T_world_base.translation for arm in paper.cell.arms]
    points += [T.translation for i in (0, 20, 40) for T in tool_placements(paper.cell, [run.q[i]])[0]]
    points.append(paper.path.pose(3.0).translation)
    slope = np.tan(np.deg2rad(0.5 * FIELD_OF_VIEW))
    for point in points:
        depth = (eye - point) @ back
        assert abs((point - eye) @ up) < slope * depth
        assert abs((point - eye) @ right) < 4 / 3 * slope * depth


def test_a_recording_without_a_scene_is_refused(scene: FakeScene, run: Recording) -> None:
    metadata = {key: value for key, value in run.metadata.items() if key != "scene"}
    with pytest.raises(SceneError, match="does not describe its cell"):
        Stage(scene, replace(run, metadata=metadata))


def test_a_recording_of_another_cell_is_refused(scene: FakeScene, run: Recording, make_cell: Any) -> None:
    other = {**run.metadata, "scene": describe_cell(make_cell(["arm7"]))}
    with pytest.raises(InvalidInputError, match="3 arms for a cell with nq = 7"):
        Stage(scene, replace(run, metadata=other))


# -- the page ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_page_is_one_file_that_names_the_run(
    run: Recording, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    told: list[tuple[int, int]] = []
    hostile = replace(run, metadata={**run.metadata, "scenario": "<script>alert(1)</script>"})
    page = export_html(hostile, tmp_path / "new" / "run.html", progress=lambda *done: told.append(done))
    text = page.read_text()
    assert len(text) < 5_000_000
    assert "PseudoInverseController, 40 steps, 3 s, ok" in text
    assert "&lt;script&gt;alert(1)" in text
    assert "<script>alert(1)" not in text
    assert told[-1] == (75, 75)
    assert [p.name for p in page.parent.iterdir()] == ["run.html"]
    assert capfd.readouterr() == ("", "")  # without viser's banner


def test_a_page_that_cannot_be_written_is_refused_first(run: Recording, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="is a folder"):
        export_html(run, tmp_path)


def test_a_missing_viser_names_the_extra(run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: Any, **options: Any) -> Any:
        if name == "viser":
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"pip install 'coopqp\[viewer\]'"):
        export_html(run, tmp_path / "run.html")


# -- live ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def live(run: Recording) -> Iterator[LiveViewer]:
    with LiveViewer(run, port=0) as shown:
        yield shown


def test_it_listens_on_this_machine_alone(live: LiveViewer) -> None:
    assert live.url.startswith("http://127.0.0.1:")


def _answer(live: LiveViewer, path: str | None = None, **headers: str) -> int:
    """Status of a request for the page, with another address or other headers than a browser's."""
    address = urlsplit(live.url)
    connection = http.client.HTTPConnection(address.netloc, timeout=10)
    connection.putrequest("GET", address.path if path is None else path, skip_host=True)
    for name, value in {"Host": address.netloc, **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    with contextlib.closing(connection):
        answer = connection.getresponse()
        # Shown in a frame, a click on another page could be led to a button of this one.
        assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        assert answer.headers["X-Frame-Options"] == "DENY"
        return answer.status


def test_foreign_pages_get_nothing(live: LiveViewer) -> None:
    """Pages of other addresses, and names that others point to this machine: neither the page nor the run."""
    port = urlsplit(live.url).port
    assert _answer(live) == 200
    assert _answer(live, Host=f"localhost:{port}", Origin=f"http://localhost:{port}") == 200
    foreign = (
        "http://evil.example",
        f"http://evil.example:{port}",
        "null",
        "http://127.0.0.1:1",
        "file://",
        "http://[",
    )
    assert {_answer(live, Origin=origin) for origin in foreign} == {403}
    hosts = (f"evil.example:{port}", "127.0.0.1:1", "127.0.0.1", "", f"127.0.0.1.evil.example:{port}", f"[:{port}")
    assert {_answer(live, Host=host) for host in hosts} == {403}


def test_the_page_is_for_those_who_know_its_key(live: LiveViewer, run: Recording) -> None:
    """Another program of this machine does not know it."""
    key = urlsplit(live.url).path
    assert len(key) > 20
    for path in (f"{key}/", f"{key}?darkMode", f"{key}/?darkMode"):
        assert _answer(live, path) == 200
    for path in ("/", "/index.html", key[:-1], key + "0", key.upper() + "/", f"/?{key[1:]}", f"/%2e{key}", f"/x{key}/"):
        assert _answer(live, path) == 403, path
    with LiveViewer(run, port=0) as another:
        assert urlsplit(another.url).path != key


def test_the_run_is_sent_to_its_own_page_only(live: LiveViewer) -> None:
    from websockets.exceptions import InvalidStatus
    from websockets.sync import client

    address, (own_page, _, _) = live.url.replace("http://", "ws://"), live.url.rpartition("/")
    with client.connect(address, origin=own_page, subprotocols=[f"viser-v{version('viser')}"]) as own:
        assert own.recv(timeout=10)
    for origin in ("http://evil.example", "null"):
        with pytest.raises(InvalidStatus, match="403"):
            client.connect(address, origin=origin)
    for origin in (own_page, None):
        with pytest.raises(InvalidStatus, match="403"):
            client.connect(address.rpartition("/")[0], origin=origin)


def test_it_plays_and_starts_again_after_a_rest(live: LiveViewer) -> None:
    assert live.update(0.75) == 10
    assert live._time.value == pytest.approx(0.75)
    assert "t = 0.75 s" in live._changing[0].content
    assert live.update(2.5) == 40
    assert live.update(1.0) == 40  # at rest at the end
    assert live.update(1.0) == 0


def test_speed_pause_and_scrub(live: LiveViewer) -> None:
    live._speed.value = "2x"
    assert live.update(0.75) == 20
    live._playing.value = False
    assert live.update(0.75) == 20
    live._time.value = 0.375
    assert live.update(0.75) == 5
    live._playing.value = True
    live._time.value = 3.0
    assert live.update(0.1) == 40


@pytest.mark.parametrize("port", [-1, 65536, True, "8080"])
def test_a_port_that_is_none_is_refused(run: Recording, port: Any) -> None:
    with pytest.raises(InvalidInputError, match="port"):
        LiveViewer(run, port=port)


def test_text_in_markdown_stays_text() -> None:
    assert viewer.plain_text("a_b *c* <d>") == "a\\_b \\*c\\* \\<d\\>"


def test_other_robots_are_shown_too(scene: FakeScene, make_cell: Any) -> None:
    """Revolute, prismatic and continuous joints; a scene read back from JSON."""
    arm = Arm.from_urdf("a", robot_path("gantry7"), tool_frame="tool")
    cell = RobotCell([arm])
    q = cell.configuration(np.full(7, 0.1))
    recording = Recording(
        time=np.array([0.0, 1.0]), q=np.array([q, q]), q_command=np.array([q, q]), velocity=np.zeros((1, 7)),
        clock=np.array([0.0, 1.0]), rate=np.ones(1), status=np.zeros(1), reference=np.tile(np.eye(4), (2, 1, 1)),
        T_object_tool=np.eye(4)[None], notes=(), metadata=json.loads(json.dumps({"scene": describe_cell(cell)})),
    )  # fmt: skip
    stage = Stage(scene, recording)
    stage.show(1)
    assert "/path/line 0" not in scene.nodes  # the object rests


# -- what stands around the arms ------------------------------------------------------------------------------------


def _surrounded(run: Recording, paper: Scenario) -> tuple[Recording, CollisionScene]:
    rng = np.random.default_rng(0)
    shapes = {
        "box": Box((0.1, 0.2, 0.3)),
        "ball": Sphere(0.1),
        "can": Cylinder(0.05, 0.2),
        "post": Capsule(0.05, 0.2),
        "stone": Hull(rng.normal(size=(12, 3))),
    }
    places = [pin.SE3(pin.exp3(rng.normal(size=3)), np.array([0.0, 3.0 + 2.0 * i, 0.5])) for i in range(len(shapes))]
    bodies = [Body(name, shape, T) for (name, shape), T in zip(shapes.items(), places, strict=True)]
    scene = CollisionScene.of(replace(paper, obstacles=tuple(bodies)), margin=0.0)
    return with_clearance(run, scene, avoided=False), scene


def test_bodies_stand_where_the_scene_says(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    recording, bodies = _surrounded(run, paper)
    recording = replace(recording, metadata=json.loads(json.dumps(recording.metadata)))
    Stage(scene, recording)
    for i, (body, (name, _, T)) in enumerate(zip(bodies.obstacles, read_bodies(recording.metadata), strict=True)):
        assert name == body.name
        np.testing.assert_allclose(T.homogeneous, body.placement.homogeneous, atol=1e-12)
        corners = np.asarray(scene.nodes[f"/bodies/{i}"].arguments[0])
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        assert np.linalg.norm(middle - T.translation) < (1.5 if name == "stone" else 1e-3)
    damaged = {**recording.metadata, "bodies": [{"kind": "Box", "name": "box"}]}
    with pytest.raises(SceneError, match="bodies are damaged"):
        Stage(FakeScene(), replace(recording, metadata=damaged))


def test_the_bodies_of_the_object_are_drawn_in_place_of_its_box(
    scene: FakeScene, run: Recording, paper: Scenario
) -> None:
    """At their places on the object, in the recording's own words; outlines go round them all."""
    shapes = {"bar": Box((0.1, 1.0, 0.1)), "knob": Sphere(0.2)}
    carried = [Body(name, shape, pin.SE3(np.eye(3), np.array([0.1, 0.5, 0.3]))) for name, shape in shapes.items()]
    bodies = CollisionScene.of(paper, carried=carried, margin=0.0)
    recording = with_clearance(run, bodies, avoided=False)
    recording = replace(recording, metadata=json.loads(json.dumps(recording.metadata)))
    assert [name for name, _, _ in read_bodies(recording.metadata, "carried")] == list(shapes)
    Stage(scene, recording)
    for node, half in (("/object/body", (0.05, 0.5, 0.05)), ("/object/body 1", (0.2, 0.2, 0.2))):
        corners = np.asarray(scene.nodes[node].arguments[0])
        np.testing.assert_allclose(corners.max(axis=0), np.array([0.1, 0.5, 0.3]) + half, atol=1e-3)
    outline = np.asarray(scene.nodes["/path/start"].arguments[0]).reshape(-1, 3)
    T = paper.path.pose(0.0).inverse()
    local = outline @ T.rotation.T + T.translation
    np.testing.assert_allclose(np.ptp(local, axis=0), [0.4, 1.0, 0.4], atol=1e-2)
    own = with_clearance(run, CollisionScene.of(paper, margin=0.0), avoided=False)
    assert "carried" not in own.metadata  # its box alone


def test_a_line_joins_the_bodies_that_are_nearest(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    recording, _ = _surrounded(run, paper)
    entry = recording.metadata["clearance"]
    stage = Stage(scene, recording)
    for sample in (0, 17, 40):
        stage.show(sample)
        i = int(np.abs(np.array(entry["times_s"]) - recording.time[sample]).argmin())
        a, b = np.asarray(scene.nodes["/nearest"].points)[0]
        assert np.linalg.norm(b - a) == pytest.approx(entry["distances_m"][i], abs=2e-4)
        assert scene.nodes["/nearest/distance"].text == f"{1e3 * entry['distances_m'][i]:.3g} mm"
        np.testing.assert_allclose(scene.nodes["/nearest/distance"].position, 0.5 * (a + b), atol=1e-6)
    for wrong in ({"points_m": [[0.0]]}, {"times_s": 0.0}):
        broken = {**recording.metadata, "clearance": {**entry, **wrong}}
        with pytest.raises(SceneError, match="nearest points are damaged"):
            Stage(FakeScene(), replace(recording, metadata=broken))


def test_arrows_show_the_force_of_each_arm(scene: FakeScene, run: Recording, paper: Scenario) -> None:
    """From its tool, along the force in the world, in proportion to the largest; the object is translucent."""
    rng = np.random.default_rng(1)
    wrenches = rng.normal(scale=40.0, size=(40, 3, 6))
    wrenches[20, 1] = 0.0
    stage = Stage(scene, replace(run, wrenches=wrenches, torques=np.zeros((40, 18))))
    arrows, largest = scene.nodes["/forces"], np.linalg.norm(wrenches[:, :, :3], axis=2).max()
    for sample in (1, 21, 40):
        stage.show(sample)
        tools = tool_placements(paper.cell, [run.q[sample]])[0]
        for k, (tool, (start, tip)) in enumerate(zip(tools, arrows.points, strict=True)):
            force = wrenches[sample - 1, k, :3]
            np.testing.assert_allclose(start, tool.translation, atol=1e-6)
            drawn = (tip - start) * largest / (0.16 * np.linalg.norm(stage.high - stage.low))
            np.testing.assert_allclose(drawn, tool.rotation @ force, atol=0.01)
            label = scene.nodes[f"/forces/{paper.cell.arm_names[k]}"]
            assert label.text == f"{np.linalg.norm(force):.3g} N"
    assert 0.0 < scene.nodes["/object/body"].opacity < 1.0
    bare = FakeScene()
    Stage(bare, run)
    assert "/forces" not in bare.nodes
    assert bare.nodes["/object/body"].opacity is None
