"""``coopqp jog`` without a script: it serves its page until Ctrl-C, then judges and writes what it recorded."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from coopqp import Recording
from coopqp.cli.main import main

_MAIN = "import sys; from coopqp.cli.main import main; sys.exit(main())"


@pytest.mark.slow
def test_it_serves_until_an_interrupt(tmp_path: Path) -> None:
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


def test_what_does_not_fit_is_named_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, words in (
        (["nobody"], "cell file (.toml, .yaml) or scenario"),
        (["paper_lift", "--script", "calls.txt", "--port", "0"], "a script opens no page"),
        (["paper_lift", "--record", str(tmp_path / "run.txt")], "ends in .npz"),
        (["hot_plate"], "engine"),
    ):
        assert main(["jog", *arguments]) == 2, arguments
        assert words in capsys.readouterr().err
