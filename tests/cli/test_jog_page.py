"""``coopqp jog`` without a script: it serves its page until Ctrl-C, then judges and writes what it recorded."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from places import CELL_FILES
from robots import simulated_robots

from coopqp import Recording
from coopqp.cli import jog
from coopqp.cli.main import main
from coopqp.drivers import MonotonicTime, SimulatedRobot
from coopqp.files.cellfile.build import CellRun

_MAIN = "import sys; from coopqp.cli.main import main; sys.exit(main())"


@pytest.mark.slow
def test_it_serves_until_an_interrupt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "led.npz"
    command = [sys.executable, "-c", _MAIN, "jog", "paper_lift", "--port", "0", "--record", str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        first = run.stdout.readline()
        assert first.startswith("http://127.0.0.1:"), run.stderr.read() if run.stderr else ""
        run.send_signal(signal.SIGINT)
        text, errors = run.communicate(timeout=60)
    assert (run.returncode, errors) == (0, "")
    assert "steps, late p50" in text
    assert "yes  Do the arms agree on where the object is?" in text
    recording = Recording.load(file)
    assert recording.metadata["scenario"] == "paper_lift"
    assert set(recording.status) == {5}  # PAUSED
    assert main(["run", "paper_lift", "--replay", str(file), "--out", str(tmp_path / "again")]) == 4  # it rests
    assert "the run is the recorded one bit for bit" in capsys.readouterr().out


def test_what_does_not_fit_is_named_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, words in (
        (["nobody"], "cell file (.toml, .yaml) or scenario"),
        (["paper_lift", "--script", "calls.txt", "--port", "0"], "a script opens no page"),
        (["paper_lift", "--record", str(tmp_path / "run.txt")], "ends in .npz"),
        (["hot_plate"], "engine"),
        (["paper_lift", "--driver", "sim"], "nothing is driven without --enable"),
        (["paper_lift", "--script", "calls.txt", "--enable"], "a script leads in simulation"),
    ):
        assert main(["jog", *arguments]) == 2, arguments
        assert words in capsys.readouterr().err


class Led:
    """Stands for the page: it presses Run."""

    def __init__(self, run: Any) -> None:
        self._run, self.closed, self.steps = run, False, 0

    def observe(self, step: Any) -> None:
        self.steps += 1
        if self.steps == 100:
            assert step.status.value == "paused"
            threading.Thread(target=self._press_run).start()

    def _press_run(self) -> None:
        self._run.call("set_override", 1.0)
        self._run.call("forward")

    def close(self) -> None:
        self.closed = True


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")
def test_it_leads_robots_through_the_control_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = tmp_path / "two_robots.toml"
    cell.write_text((CELL_FILES / "two_robots.toml").read_text().replace("duration_s = 2.0", "duration_s = 0.8"))
    opened: list[Led] = []

    def link(run: Any, *_: Any) -> Led:
        opened.append(Led(run))
        return opened[0]

    def robots(run: Any, kind: str | None) -> dict[str, SimulatedRobot]:
        assert kind == "sim"
        return simulated_robots(run.scenario.cell, run.scenario.q_start, MonotonicTime(), (0.01, 0.01))

    monkeypatch.setattr(jog, "_linked", link)
    monkeypatch.setattr(CellRun, "drivers", robots)  # in this process, whatever else the machine does
    file = tmp_path / "led.npz"
    given = ["jog", str(cell), "--driver", "sim", "--enable", "two_robots", "--record", str(file)]
    assert main(given) == 0, capsys.readouterr().err
    assert "finished after" in capsys.readouterr().out
    assert opened[0].closed
    assert Recording.load(file).clock[-1] == pytest.approx(0.8)
    assert main([*given[:-4], "--enable", "another"]) == 2
    assert "the cell's name is 'two_robots'" in capsys.readouterr().err
