"""benchmarks/: shared functions, the cell exported for peers, and short runs with the installed peers."""

from __future__ import annotations

import io
import itertools
import json
import sys
import types
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from places import BENCHMARKS

from coopqp import CollisionScene, QPController, Status
from coopqp.collision import Body, Hull
from coopqp.scenarios import plate_and_post
from coopqp.simulation import tool_placements

sys.path.insert(0, str(BENCHMARKS / "peers"))

import common
import compare_peers
import contestants
import export_cell
import peer_cases
import protocol
import scaling

TINY = compare_peers.Plan(arms=(3,), rounds=2, steps=4, round_s=0.05, behave_s=0.05, all_modes=False)


@pytest.fixture(scope="module")
def paper_case() -> peer_cases.Case:
    return peer_cases.build("fast")


class TestCommon:
    def test_percentiles(self) -> None:
        assert common.percentiles(np.arange(101.0)) == {"p50_us": 50.0, "p99_us": 99.0}
        assert common.percentiles([1.0], shares=(99.9,)) == {"p999_us": 1.0}
        assert common.percentiles([]) == {"p50_us": None, "p99_us": None}

    def test_rounds_alternate_and_turn_round(self) -> None:
        order: list[str] = []

        def contestant(name: str) -> Any:
            return lambda: [float(len(order)), order.append(name) or 0.0]

        samples = common.interleaved({"a": contestant("a"), "b": contestant("b")}, rounds=3)
        assert order == ["a", "b", "b", "a", "a", "b"]
        assert samples["a"].tolist() == [0.0, 0.0, 3.0, 0.0, 4.0, 0.0]

    def test_table(self) -> None:
        text = common.markdown_table([{"a": 1.23456, "b": None, "c": True}, {"a": 12345.6, "b": "x|y"}], "abc")
        assert text.splitlines()[2:] == ["| 1.23 | – | yes |", "| 12346 | x\\|y | – |"]

    def test_bar_only_on_a_terminal(self) -> None:
        stream = io.StringIO()
        bar = common.Progress(3, stream=stream)
        bar.advance("x")
        bar.close()
        assert stream.getvalue() == ""
        stream.isatty = lambda: True  # type: ignore[method-assign]
        bar = common.Progress(3, stream=stream)
        bar.advance("x")
        assert "1/3 x" in stream.getvalue()

    def test_files(self, tmp_path: Path) -> None:
        description = common.describe("test", {"rounds": 3})
        assert "rounds 3" in common.header(description)
        common.save([{"a": 1}], description, json_file=tmp_path / "r.json", out=tmp_path / "o", files={"t.md": b"x"})
        assert json.loads((tmp_path / "r.json").read_text()) == [{"a": 1}]
        assert json.loads((tmp_path / "o/machine.json").read_text())["machine"]["cores"]
        assert (tmp_path / "o/t.md").read_bytes() == b"x"

    @pytest.mark.parametrize(("arms", "joints"), [(1, 6), (2, 7), (5, 6)])
    @pytest.mark.parametrize("path", ["nominal", "zigzag"])
    def test_ring(self, arms: int, joints: int, path: str) -> None:
        s = common.ring(arms=arms, joints=joints, path=path)
        assert (len(s.cell), s.cell.nv) == (arms, arms * joints)
        tools = tool_placements(s.cell, [s.q_start])[0]
        for T, X in zip(tools, s.grasp.T_object_tool, strict=True):
            assert np.allclose((T * X.inverse()).homogeneous, s.path.pose(0.0).homogeneous, atol=1e-9)


class TestExport:
    @pytest.mark.parametrize("kind", ["urdf", "mjcf"])
    @pytest.mark.parametrize(("arms", "joints"), [(3, 6), (11, 7)])
    def test_same_kinematics(self, kind: str, arms: int, joints: int, tmp_path: Path, rng: np.random.Generator) -> None:
        cell = common.ring(arms=arms, joints=joints).cell
        file = tmp_path / "cell.xml"
        file.write_text(getattr(export_cell, kind)(cell))
        model = (pin.buildModelFromUrdf if kind == "urdf" else pin.buildModelFromMJCF)(str(file))
        joint_names, tools = export_cell.names(cell)
        assert list(model.names)[1:] == joint_names
        assert np.array_equal(model.lowerPositionLimit, cell.limits.lower)
        assert np.array_equal(model.upperPositionLimit, cell.limits.upper)
        if kind == "urdf":
            assert np.array_equal(model.velocityLimit, cell.limits.velocity)
        data = model.createData()
        q = rng.uniform(-2.0, 2.0, cell.nv)
        pin.framesForwardKinematics(model, data, q)
        for tool, T in zip(tools, tool_placements(cell, [q])[0], strict=True):
            assert np.abs(data.oMf[model.getFrameId(tool)].homogeneous - T.homogeneous).max() < 1e-12

    def test_task(self, paper_case: peer_cases.Case, tmp_path: Path) -> None:
        task = json.loads(contestants.hand_over(paper_case, tmp_path / "task").read_text())
        assert len(task["poses"]) == 250
        assert np.allclose(task["poses"][-1], paper_case.scenario.path.goal.homogeneous)
        assert set(task["speed"]) == {1.0}
        assert len(task["tools"]) == len(task["grasp"]) == 3

    def test_bodies_that_keep_distances(self, tmp_path: Path) -> None:
        task = plate_and_post()
        scene = CollisionScene.of(task, margin=0.02)
        file = contestants.hand_over(peer_cases.Case("post", task, 10), tmp_path / "task", scene)
        given = json.loads(file.read_text())["scene"]
        assert given["margin"] == 0.02
        assert len(given["pairs"]) == len(scene.built.labels)
        geoms = list(ElementTree.parse(file.parent / "cell.xml").iter("geom"))
        assert len(geoms) == len(given["shapes"]) == len(scene.built.names)
        post = scene.built.names.index("post")
        assert given["shapes"][post] | {"placement": None} == {
            "joint": 0, "placement": None, "kind": "capsule", "half": [0.05, 0.15],
        }  # fmt: skip
        assert np.allclose(given["shapes"][post]["placement"], task.obstacles[0].placement.homogeneous)
        mesh = CollisionScene.of(task, obstacles=[Body("rock", Hull(np.vstack([np.eye(3), np.zeros(3)])))], margin=0.0)
        with pytest.raises(ValueError, match="not exported"):
            export_cell.shapes(mesh)


class TestCases:
    def test_mismatch_is_5_mm(self) -> None:
        case = peer_cases.build("mismatch")
        worth = compare_peers.judge(case, [case.scenario.q_start] * 2)
        assert worth["chain_mm"] == pytest.approx(5.0, abs=1e-6)
        assert worth["path_mm"] < 1e-6  # the first arm has no error

    def test_outside_is_10_mrad(self) -> None:
        case = peer_cases.build("outside")
        worth = compare_peers.judge(case, [case.scenario.q_start] * 2)
        assert worth["limit_excess"] == pytest.approx(0.010, abs=1e-9)
        assert worth["chain_mm"] < 1e-6

    def test_unknown(self) -> None:
        with pytest.raises(ValueError, match="no case"):
            peer_cases.build("nothing")

    @pytest.mark.parametrize("name", peer_cases.COST)
    def test_cost(self, name: str) -> None:
        """Readings are one sample late and noisy; servos are watched, and a QP is solved, where the case says so."""
        case = peer_cases.build(name)
        read = name in ("measured", "watched")
        assert case.noise == (1e-4 if read else None)
        assert case.options.shortcut is (name != "qp")
        assert (case.options.supervision.stiffness is not None) is (name == "watched")
        s = case.scenario
        controller = QPController(s.cell, s.grasp, s.path, dt=s.dt, options=case.options)
        controller.reset(s.q_start)
        rng, before, command = np.random.default_rng(0), s.q_start, s.q_start
        for _ in range(300):
            step = controller.step(before + rng.uniform(-1e-4, 1e-4, s.cell.nq) if read else None)
            before, command = command, step.q_next
            assert step.status is (Status.SLOWED if name == "zigzag" else Status.TRACKING), step.explain()
            assert (step.solver.name != "none") is (name == "qp")
        assert (step.rate < 1.0) is (name == "zigzag")


class TestProtocol:
    """A loop as a runner closes it, on a motion that writes down what it gets."""

    class Motion(protocol.Timed):
        def __init__(self, task: Any, fails: tuple[int, ...] = ()) -> None:
            self._task, self._fails, self.seen = task, fails, list[Any]()

        def start(self) -> None:
            self.seen.clear()

        def step(self, i: int, reading: Any) -> Any:
            self.seen.append(reading)
            if i in self._fails:
                raise ArithmeticError("no command")
            return np.full(2, float(i + 1))

    @staticmethod
    def task(noise: float | None) -> Any:
        rows = None if noise is None else np.random.default_rng(0).uniform(-noise, noise, (protocol.NOISE_ROWS, 2))
        return types.SimpleNamespace(q_start=np.zeros(2), poses=np.zeros((5, 4, 4)), noise=rows)

    def test_readings_are_one_sample_late_and_noisy(self) -> None:
        task = self.task(1e-4)
        motion = self.Motion(task)
        session = protocol._Session(motion, task)
        for _ in range(4):
            assert session.advance()[1] == ""
        late = [0.0, 0.0, 1.0, 2.0]  # command i is i, the start is 0
        noise = [reading - was for reading, was in zip(motion.seen, late, strict=True)]
        assert all(0.0 < np.abs(n).max() <= 1e-4 for n in noise)
        assert len({tuple(n) for n in noise}) == 4
        session.advance()  # the path ends: from the start again, where the servos stand
        assert session.i == 0
        session.advance()
        assert np.abs(motion.seen[0]).max() <= 1e-4

    def test_no_reading_where_the_loop_is_not_closed_on_it(self) -> None:
        motion = self.Motion(self.task(None))
        protocol._Session(motion, motion._task).advance()
        assert motion.seen == [None]

    def test_arms_hold_still_where_there_is_no_command(self) -> None:
        motion = self.Motion(self.task(None), fails=(1,))
        session = protocol._Session(motion, motion._task)
        notes = [session.advance()[1] for _ in range(2)]
        assert notes == ["", "ArithmeticError: no command"]
        assert session.command.tolist() == [1.0, 1.0]


class TestAgainstPlaco:
    """coopqp's records, compared with a PlaCo whose times are known."""

    @pytest.fixture(scope="class")
    @classmethod
    def records(cls, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
        times = {("placo", "nominal"): 20.0, ("placo", "measured"): 40.0}

        class Fake:
            version, modes = "1", ("hard scaled",)

            def __init__(self, name: str) -> None:
                self.name, self._case = name, ""

            @classmethod
            def start(cls, name: str, cache: Path, *, install: bool) -> Fake:
                return cls(name)

            def load(self, file: Path) -> None:
                self._case = json.loads(file.read_text())["case"]

            def ask(self, *, do: str, timeout: float, **command: Any) -> dict[str, Any]:
                assert self.name == "coopqp" or self._case in ("nominal", "measured", "zigzag")
                us = times.get((self.name, self._case), 10.0)
                q = [compare_peers.peer_cases.build("nominal").scenario.q_start.tolist()] * 2
                return {"us": [us] * 98 + [2.0 * us] * 2, "q": q, "failures": 0, "note": "", "least": 1.0}

            def stop(self) -> None:
                pass

        plan = replace(TINY, cases=peer_cases.COST)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(compare_peers, "Contestant", Fake)
            return compare_peers.compare(["placo"], plan, tmp_path_factory.mktemp("peers"), install=False)

    def test_measured_by_measured_others_by_nominal(self, records: list[dict[str, Any]]) -> None:
        own = {(r["case"], r["pacing"]): r for r in records if r["peer"] == "coopqp"}
        assert len(own) == 10
        for (case, _), r in own.items():
            assert r["placo_p50_us"] == (40.0 if case == "measured" else 20.0)
            assert r["ratio_placo"] == r["p99_ratio_placo"] == (0.25 if case == "measured" else 0.5)
        placo = [r for r in records if r["peer"] == "placo"]
        assert {r["case"] for r in placo} == {"nominal", "measured", "zigzag"}
        assert {r["ratio"] for r in placo if r["case"] == "nominal"} == {0.5}
        assert all(r["ratio_placo"] is None for r in placo)

    def test_targets_stand_beside_the_figures(
        self, records: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        target = compare_peers.Target
        targets = (
            target("nominal", "hot", "ratio_placo", 0.6),
            target("measured", "1 kHz", "p99_ratio_placo", 0.2),
        )
        monkeypatch.setattr(compare_peers, "TARGETS", targets)
        text = compare_peers.against_placo(records)
        assert "0.5 (≤ 0.6: met)" in text
        assert "0.25 (≤ 0.2: missed)" in text

    def test_every_target_is_a_figure_of_the_full_run(self) -> None:
        for t in compare_peers.TARGETS:
            assert t.case in peer_cases.COST
            assert t.arms in compare_peers.FULL.arms
            assert t.pacing in contestants.PACES
            assert t.key in compare_peers.KEYS
        assert compare_peers.FULL.rounds * compare_peers.FULL.steps >= 2000


class TestJudge:
    def test_object_off_its_path(self, paper_case: peer_cases.Case) -> None:
        s = paper_case.scenario
        corners = [s.path.pose(float(c)) for c in np.linspace(0.0, s.path.duration, 50)]
        half = s.path.pose(0.5 * s.path.duration)
        moved = half.translation + np.array([0.003, 0.0, 0.0])  # perpendicular to the vertical path
        away, turned = compare_peers._off_path(
            np.array([moved]), [half.rotation @ pin.exp3(np.array([0, 0.02, 0]))], corners
        )
        assert away[0] == pytest.approx(0.003, rel=1e-6)
        assert turned[0] == pytest.approx(0.02, rel=1e-3)

    def test_ratio_is_of_each_round(self) -> None:
        assert (
            contestants.ratio([[1, 1], [10, 10], []], [[2, 2], [20, 20], [3]]) == 0.5
        )  # the machine got ten times slower
        assert contestants.ratio([], [[1.0]]) is None
        assert contestants.ratio([[1, 1, 3]], [[1, 1, 2]], share=100.0) == 1.5


def fake_peer(folder: Path, monkeypatch: pytest.MonkeyPatch, program: str) -> contestants.Contestant:
    (folder / "peers").mkdir()
    hello = 'import sys, time; print(\'{"version": "1", "modes": ["only"]}\', flush=True); sys.stdin.readline()\n'
    (folder / "peers" / "run_fake.py").write_text(hello + program)
    monkeypatch.setattr(contestants, "HERE", folder)
    return contestants.Contestant("fake", Path(sys.executable))


class TestContestant:
    def test_hangs(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        peer = fake_peer(tmp_path, monkeypatch, "time.sleep(60)\n")
        with pytest.raises(contestants.NotAvailable, match="no answer"):
            peer.ask(do="load", timeout=0.2)
        with pytest.raises(contestants.NotAvailable, match="no answer"):
            peer.ask(do="load", timeout=0.2)  # at once: it was ended

    def test_dies(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        peer = fake_peer(tmp_path, monkeypatch, "sys.exit('out of luck')\n")
        with pytest.raises(contestants.NotAvailable, match="out of luck"):
            peer.ask(do="load", timeout=10.0)

    def test_other_kinematics(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        peer = fake_peer(tmp_path, monkeypatch, "print('{\"kinematics_error\": 1e-6}', flush=True)\n")
        with pytest.raises(contestants.NotAvailable, match="kinematics"):
            peer.load(tmp_path)
        peer.stop()

    @pytest.mark.slow
    def test_cannot_be_installed(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(contestants.PINS, "pink", ("coopqp-has-no-such-peer==1.0",))
        monkeypatch.setattr(contestants, "PIP_INSTALL", (*contestants.PIP_INSTALL, "--no-index"))
        with pytest.raises(contestants.NotAvailable, match="cannot be installed"):
            contestants.environment("pink", tmp_path, install=True)
        with pytest.raises(contestants.NotAvailable, match="not installed"):
            contestants.environment("pink", tmp_path, install=False)


@pytest.mark.slow
def test_peers_that_are_not_installed_are_reported(tmp_path: Path) -> None:
    records = compare_peers.compare(["mink", "placo"], TINY, tmp_path, install=False)
    assert all(set(r) == set(compare_peers.KEYS) for r in records)
    missing = [r for r in records if r["peer"] != "coopqp"]
    assert [(r["peer"], r["version"], r["note"]) for r in missing] == [
        ("mink", "1.3.0", "not installed"),
        ("placo", "0.10.2", "not installed"),
    ]
    own = [r for r in records if r["peer"] == "coopqp"]
    cost = {"nominal", "measured", "watched", "qp", "zigzag"}
    assert {r["case"] for r in own} == {"fast", "mismatch", "outside"} | cost
    assert sorted((r["case"], r["pacing"]) for r in own if r["pacing"]) == sorted(
        itertools.product(cost, contestants.PACES)
    )
    for r in own:
        assert r["ratio_placo"] is r["p99_ratio_placo"] is r["placo_p50_us"] is r["placo_p99_us"] is None
        assert r["failures"] == 0, r
        assert r["p50_us"] > 0.0
        if r["case"] not in ("mismatch",):
            assert r["chain_mm"] < 0.01, r
    assert all(r["ratio"] == 1.0 for r in own if r["pacing"])
    assert "not installed" in compare_peers.report(records)


@pytest.mark.slow
def test_quick_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(compare_peers, "QUICK", TINY)
    file, out = tmp_path / "records.json", tmp_path / "out"
    assert compare_peers.main(["--quick", "--no-install", "--json", str(file), "--out", str(out)]) == 0
    assert "coopqp solver auto" in capsys.readouterr().out
    records = json.loads(file.read_text())
    assert {r["peer"] for r in records} == {"coopqp", *contestants.PINS}  # run, or said why not
    contract = {"peer", "version", "case", "arms", "mode", "pacing", "p50_us", "p99_us", "ratio", "ratio_placo"}
    contract |= {"p99_ratio_placo", "chain_mm", "path_mm", "failures"}
    for r in records:
        assert contract <= set(r)
        assert r["note"] or r["p50_us"], r
    text = (out / "peers.md").read_text()
    assert "## coopqp ÷ PlaCo" in text
    for r in records:  # a hard chain and hard limits leave no answer there, wherever a peer is installed
        if r["case"] == "outside" and r["mode"] and r["mode"].startswith("hard"):
            assert r["failures"] > 0


@pytest.mark.slow
def test_scaling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = scaling.Plan(arms=(1, 3), peers=(3,), rounds=2, steps=4, round_s=0.05)
    monkeypatch.setattr(scaling, "QUICK", plan)
    file, out = tmp_path / "records.json", tmp_path / "out"
    assert scaling.main(["--quick", "--json", str(file), "--out", str(out), "--cache", str(tmp_path)]) == 0
    records = json.loads(file.read_text())
    assert all(set(r) == set(scaling.KEYS) for r in records)
    own = [r for r in records if r["peer"] == "coopqp"]
    assert {(r["arms"], r["joints"]) for r in own} == {(1, 6), (3, 6), (1, 7), (3, 7)}
    assert all(r["p99_us"] >= r["p50_us"] > 0.0 for r in own)
    assert {r["peer"]: r["note"] for r in records if r["peer"] != "coopqp"} == {
        "pink": "not installed; compare_peers.py installs it",
        "placo": "not installed; compare_peers.py installs it",
    }


@pytest.mark.slow
def test_a_size_that_does_not_fit_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "free_memory", lambda: 1e6)
    records = scaling.scale([], scaling.Plan(arms=(8,)), tmp_path)
    assert [(r["arms"], r["joints"], r["p50_us"]) for r in records] == [(8, 6, None), (8, 7, None)]
    assert all("GiB" in r["note"] for r in records)
