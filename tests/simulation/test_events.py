"""An operator's calls are recorded, made again bit for bit, read from scripts and exported."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first
from runs import cooperative, limited_once

from coopqp import Clearance, CollisionScene, InvalidInputError, QPController, Recording, simulate
from coopqp.cli.main import main
from coopqp.files import write_csv
from coopqp.scenarios import Scenario, dual_arm7, paper_lift, plate_and_post
from coopqp.simulation import Event, differs_from, events_of, operating
from coopqp.simulation.events import read_script

SCRIPT = """\
# a comment, and an empty line

0.3 set_override 0.8
0.5 pause
0.8 jog 0 0 0.05 0 0 0.1 world for 0.4
1.5 return_to_path    # it rests there
2.2 reverse
3.0 forward
3.1 shift_path 0.01 0 0
"""


def random_calls(controller: Any, done: int) -> None:
    """Calls of every kind, whatever the run has been so far."""
    rng = np.random.default_rng(done)
    now, end = controller.program_clock, controller.path.duration
    if done % 20 or rng.random() < 0.5:
        return
    calls = (
        controller.pause, controller.resume, controller.forward, controller.return_to_path, controller.release,
        lambda: controller.set_override(rng.uniform(0.2, 1.0)), lambda: controller.run_to(rng.uniform(0.0, end)),
        lambda: controller.reverse(rng.uniform(0.0, now)), lambda: controller.gear(now, speed=0.4),
        lambda: controller.jog(rng.normal(size=6) * 0.1, frame="world", deadman_s=0.3),
        lambda: controller.engage(pin.SE3.Identity()), lambda: controller.target(pin.exp6(rng.normal(size=6) * 0.02)),
    )  # fmt: skip
    calls[int(rng.integers(len(calls)))]()


def beside_a_post() -> tuple[Scenario, QPController]:
    task = plate_and_post()
    constraints = [Clearance(CollisionScene.of(task, margin=0.02))]
    return task, QPController(task.cell, task.grasp, task.path, dt=0.005, constraints=constraints)


def redundant() -> tuple[Scenario, QPController]:
    task = limited_once(dual_arm7, 5.0)
    return task, cooperative(task, dt=0.005)


@pytest.mark.parametrize("make", slow_but_first([redundant, beside_a_post]))
def test_a_recorded_run_is_repeated_bit_for_bit(make: Any, tmp_path: Path) -> None:
    task, controller = make()
    run = simulate(controller, q_start=task.q_start, duration=4.0, operate=random_calls)
    loaded = Recording.load(run.save(tmp_path / "run.npz"))
    events = events_of(loaded)
    assert len(events) > 5
    assert all(0.0 <= event.clock <= task.path.duration for event in events)
    again = simulate(make()[1], q_start=task.q_start, duration=4.0, operate=operating(events, run.metadata["begun"]))
    assert differs_from(run, again) is None
    fewer = simulate(make()[1], q_start=task.q_start, duration=4.0, operate=operating(events[1:]))
    assert differs_from(run, fewer) is not None


def test_a_script_is_read_line_by_line(tmp_path: Path) -> None:
    file = tmp_path / "script"
    file.write_text(SCRIPT, encoding="utf-8")
    events = read_script(file, 0.005)
    assert [event.call for event in events if event.call != "jog"] == [
        "set_override", "pause", "return_to_path", "reverse", "forward", "shift_path"
    ]  # fmt: skip
    jogs = [event for event in events if event.call == "jog"]
    assert [event.step for event in jogs] == list(range(160, 240, 10))
    assert jogs[0].value == [[0.0, 0.0, 0.05, 0.0, 0.0, 0.1], "world", 0.1]


@pytest.mark.parametrize(
    ("line", "steps", "call", "value"),
    [
        ("0 pause", [0], "pause", None),
        ("0.996 resume # at once", [199], "resume", None),
        ("1 reverse", [200], "reverse", 0.0),
        ("1 reverse 0.25", [200], "reverse", 0.25),
        ("1 run_to 2.5", [200], "run_to", 2.5),
        ("1 signal part in place", [200], "signal", "part in place"),
        (
            "1 shift_path 0.1 -0.2 0.3",
            [200],
            "shift_path",
            [[[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]], 0.1],
        ),
        ("1 jog 1 2 3 4 5 6", [200], "jog", [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "object", 0.1]),
        ("1 jog 1 2 3 4 5 6 for 0.11", [200, 210, 220], "jog", [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "object", 0.1]),
        ("1 jog 1 2 3 4 5 6 world for 0.05", [200], "jog", [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "world", 0.1]),
    ],
)
def test_each_call_of_a_script_comes_with_its_numbers(
    line: str, steps: list[int], call: str, value: Any, tmp_path: Path
) -> None:
    """At steps of 5 ms; a jog is repeated every 50 ms for as long as it lasts."""
    file = tmp_path / "script"
    file.write_text(f"\n{line}\n", encoding="utf-8")
    events = read_script(file, 0.005)
    assert [event.step for event in events] == steps
    assert {event.call for event in events} == {call}
    assert all(event.value == value for event in events)
    assert all(event.place == f"{file}, line 2" for event in events)
    slow = read_script(file, 0.2)
    assert [event.step for event in slow] == [round(steps[0] / 40)], "a period longer than 50 ms"


class Called:
    """Keeps the calls that it gets."""

    override, paused = 0.5, True

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *values, **more: self.calls.append((name, *values, more))


@pytest.mark.parametrize(
    ("call", "value", "expected"),
    [
        ("pause", None, ("pause", {})),
        ("set_override", 0.5, ("set_override", 0.5, {})),
        ("signal", "go", ("signal", "go", {})),
        ("gear", [1.5, 0.4], ("gear", 1.5, {"speed": 0.4})),
        ("jog", [[0.1] * 6, "world", 0.3], ("jog", [0.1] * 6, {"frame": "world", "deadman_s": 0.3})),
        ("jog", [[0.1] * 6, "tool", 0.0], ("jog", [0.1] * 6, {"frame": "tool", "deadman_s": 1e-9})),
    ],
)
def test_a_call_is_made_with_the_values_that_it_was_recorded_with(call: str, value: Any, expected: Any) -> None:
    made = Called()
    Event(0, call, value).make(made)
    assert made.calls == [expected]


def test_poses_are_handed_on_as_matrices() -> None:
    made, T = Called(), pin.exp6(np.array([0.1, -0.2, 0.3, 0.4, 0.5, -0.6])).homogeneous
    Event(0, "retarget", T.tolist()).make(made)
    Event(0, "shift_path", [T.tolist(), 0.25]).make(made)
    (retarget, goal, _), (shift, by, more) = made.calls
    assert (retarget, shift, more) == ("retarget", "shift_path", {"over": 0.25})
    np.testing.assert_array_equal(goal, T)
    np.testing.assert_array_equal(by, T)


def test_calls_are_made_in_turn_ahead_of_their_steps() -> None:
    """Those that are late are made as soon as there is a step, in their order, and once."""
    made = Called()
    operate = operating([Event(4, "resume"), Event(2, "pause"), Event(2, "forward"), Event(7, "release")])
    at = []
    for done in (0, 1, 2, 3, 6, 7, 8):
        before = len(made.calls)
        operate(made, done)
        at += [(done, name) for name, _ in made.calls[before:]]
    assert at == [(2, "pause"), (2, "forward"), (6, "resume"), (7, "release")]
    operating([], {"override": 0.5, "paused": True})(made, 0)
    for begun in ({"override": 0.5, "paused": False}, {"override": 1.0, "paused": True}):
        with pytest.raises(InvalidInputError, match=r"began with an override of (0\.5|1), paused: (True|False)"):
            operating([], begun)(made, 0)


@pytest.mark.parametrize(
    "line", ["1 pause 2", "1 run_to", "1 set_override", "1 set_override 1 2", "1 signal", "1 shift_path 1 2",
             "1 jog 0 0 0 0 0 0 for -1", "1 jog 0 0 0 0 0 0 for 1e4", "1 jog 0 0 0 0 0 0 for", "1e9 pause",
             "1 jog 0 0 0 0 0 0 0 world"]
)  # fmt: skip
def test_a_call_with_other_numbers_is_named(line: str, tmp_path: Path) -> None:
    file = tmp_path / "script"
    file.write_text(f"# two\n\n{line}\n", encoding="utf-8")
    with pytest.raises(InvalidInputError, match=r"line 3: "):
        read_script(file, 0.005)


@pytest.mark.parametrize(
    "line", ["soon pause", "1.0", "1.0 dance", "1 reverse a", "-1 pause", "1 jog 1 2 3", "1 jog 0 0 0 0 0 0 for x"]
)
def test_a_line_that_is_no_call_is_named(line: str, tmp_path: Path) -> None:
    file = tmp_path / "script"
    file.write_text(f"0.1 pause\n{line}\n", encoding="utf-8")
    with pytest.raises(InvalidInputError, match=r"line 2.* calls are pause, .* signal, "):
        read_script(file, 0.005)


def test_what_a_controller_does_not_take_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="takes no call 'reset'"):
        Event(0, "reset").make(cooperative(paper_lift()))
    with pytest.raises(InvalidInputError, match="takes no call 'pause'"):
        Event(0, "pause").make(object())
    operate = operating([], {"override": 0.5, "paused": False})
    with pytest.raises(InvalidInputError, match="began with an override"):
        operate(cooperative(paper_lift()), 0)


@pytest.mark.slow
def test_the_command_repeats_and_exports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script, record = tmp_path / "script", tmp_path / "run.npz"
    script.write_text(SCRIPT, encoding="utf-8")
    assert main(["jog", "paper_lift", "--script", str(script), "--record", str(record), "--quiet"]) == 0
    assert main(["run", "paper_lift", "--replay", str(record), "--out", str(tmp_path / "again")]) == 0
    assert "the recorded one bit for bit" in capsys.readouterr().out
    assert main(["run", "fast_lift", "--replay", str(record), "--out", str(tmp_path / "other")]) == 4
    assert "differs from" in capsys.readouterr().err
    run = Recording.load(record)
    table = write_csv(run, tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()
    at = table[0].split(",").index("call")
    assert [line.split(",")[at] for line in table[1:]].count("pause") == 1


def test_a_bad_script_or_name_of_a_recording_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "script"
    script.write_text("1 reverse 100\n", encoding="utf-8")
    assert main(["jog", "paper_lift", "--script", str(tmp_path / "none")]) == 2
    assert main(["jog", "paper_lift", "--script", str(script), "--quiet"]) == 2
    assert f"{script}, line 1: " in capsys.readouterr().err
    assert main(["jog", "paper_lift", "--script", str(script), "--record", "run.csv"]) == 2
    assert "ends in .npz" in capsys.readouterr().err
