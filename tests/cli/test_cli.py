"""The command line: its files, its output, and its errors."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from processes import python

from coopqp import __version__
from coopqp.cli import demo, main as cli
from coopqp.errors import OutputError

PICTURES = {"paper_lift.png", "figure5.png", "figure5_orientation.png", "joints.png"}


def coopqp(*arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "import sys; from coopqp.cli.main import main; sys.exit(main())", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)  # type: ignore[call-overload,no-any-return]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], Path]:
    """One complete run in an empty folder."""
    folder = tmp_path_factory.mktemp("demo")
    options = {"cwd": folder, "env": {**os.environ, "FORCE_COLOR": "", "COLUMNS": "200"}}
    return coopqp("demo", "--steps", "12", "6", "--out", "pictures", "--json", "new/records.json", **options), folder


@pytest.mark.slow
def test_the_demo_writes_its_files_and_nothing_else(
    finished: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    result, folder = finished
    assert result.returncode == 0, result.stderr
    files = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert files == {f"pictures/{name}" for name in PICTURES} | {"new/records.json"}
    assert all((folder / file).read_bytes().startswith(b"\x89PNG") for file in files if file.endswith(".png"))


@pytest.mark.slow
def test_the_demo_prints_a_table_and_the_files(finished: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    result, folder = finished
    table, files = result.stdout.split("\n\n")
    head, *rows = [line.split() for line in table.splitlines()]
    records = json.loads((folder / "new" / "records.json").read_text())
    assert head == list(records[0])
    assert [row[:3] for row in rows] == [[r["method"], r["solver"], str(r["steps"])] for r in records]
    assert [(r["method"], r["steps"]) for r in records] == [(m, n) for m in demo.METHODS for n in (6, 12)]
    written = files.split("\n")
    assert written[0] == "written:"
    assert all((folder / line.strip()).is_file() for line in written[1:] if line)


@pytest.mark.slow
def test_output_that_is_no_terminal_is_plain(finished: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    result, _ = finished
    assert "\033" not in result.stdout + result.stderr
    assert result.stderr.splitlines()[0] == "running pseudo_inverse, N = 6"


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        cli.main(["--version"])
    assert exit_.value.code == 0
    said = capsys.readouterr().out
    assert said.splitlines()[0] == f"coopqp {__version__}"
    assert "\nsolver ldp\n" in said
    for package in ("pin", "numpy", "osqp"):
        assert f"{package} {metadata.version(package)}" in said


def test_a_terminal_gets_a_bar_and_colours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for stream in ("stdout", "stderr"):
        monkeypatch.setattr(f"sys.{stream}.isatty", lambda: True)
    monkeypatch.setattr(demo, "demo_pictures", lambda *_: {"a.png": b"1"})
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert cli.main(["demo", "--steps", "4", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    assert "%" in printed.err
    assert printed.out.startswith("\033[1mmethod")
    monkeypatch.setenv("NO_COLOR", "1")
    assert cli.main(["demo", "--steps", "4", "--out", str(tmp_path)]) == 0
    assert "\033" not in capsys.readouterr().out


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_an_output_that_cannot_write_a_character_gets_its_escape(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def said(*line: str) -> str:
        stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
        monkeypatch.setattr(sys, "stdout", stream)
        assert cli.main(line) == 0
        stream.flush()
        return stream.buffer.getvalue().decode(encoding)  # type: ignore[attr-defined]

    assert r"\u03c3_min" in said("check", "dual_arm7")
    assert "lower_deg" in said("schema")
    assert "σ" in json.dumps(json.loads(said("schema", "--json")), ensure_ascii=False)


def test_the_command_is_installed() -> None:
    command = shutil.which("coopqp", path=str(Path(sys.executable).parent))
    assert command is not None, "install the package: pip install --editable ."
    result = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert result.stdout.startswith(f"coopqp {__version__}\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "required: COMMAND"),
        (["demos"], "demos"),
        (["demo", "--steps"], "--steps"),
        (["demo", "--steps", "0"], "'0' is not a whole number"),
        (["demo", "--steps", "-5"], "'-5' is not a whole number"),
        (["demo", "--steps", "40", "1.5"], "'1.5' is not a whole number"),
        (["demo", "--steps", "many"], "'many' is not a whole number"),
        (["demo", "--solver", "proxpq"], "Did you mean 'proxqp'?"),
        (["demo", "--out", "{file}"], "is a file, not a folder"),
        (["demo", "--out", "{file}/deeper"], "is a file, not a folder"),
        (["demo", "--json", "{folder}"], "it is a folder"),
        (["demo", "--json", "{file}/records.json"], "is a file, not a folder"),
        (["demo", "--colour"], "--colour"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "run_method", lambda *_, **__: pytest.fail("ran before its input was checked"))
    file, folder = tmp_path / "file", tmp_path / "folder"
    file.touch()
    folder.mkdir()
    assert cli.main([text.format(file=file, folder=folder) for text in arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("coopqp: error: ")
    assert printed.err.count("\n") == 1
    assert message in printed.err
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["file", "folder"]


def test_a_folder_without_permission_is_status_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: False)  # works for the superuser, too
    assert cli.main(["demo", "--out", str(tmp_path / "new")]) == 2
    assert f"no permission on {tmp_path}" in capsys.readouterr().err


def test_without_matplotlib_the_demo_prints_its_table_and_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    records = tmp_path / "records.json"
    assert cli.main(["demo", "--steps", "4", "--out", str(tmp_path / "new"), "--json", str(records)]) == 0
    out, err = capsys.readouterr()
    assert "pseudo_inverse_literal" in out
    assert (
        err.splitlines()[-1] == "coopqp: no pictures: this needs the package 'matplotlib': pip install 'coopqp[plot]'"
    )
    assert list(tmp_path.iterdir()) == [records]


def test_a_failure_while_writing_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr(demo, "demo_pictures", lambda *_: {"a.png": b"1", "b.png": b"2"})
    monkeypatch.setattr(Path, "replace", full)
    out, records = tmp_path / "out", tmp_path / "records.json"
    assert cli.main(["demo", "--steps", "4", "--out", str(out), "--json", str(records), "--quiet"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []


def test_quiet_prints_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo, "demo_pictures", lambda *_: {"a.png": b"1"})
    assert cli.main(["demo", "--steps", "4", "--out", str(tmp_path), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_an_interrupt_is_status_130(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(demo, "run_demo", interrupted)
    assert cli.main(["demo", "--out", str(tmp_path / "new")]) == 130
    assert capsys.readouterr().err == "coopqp: interrupted\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_control_c_stops_a_run_without_a_traceback(tmp_path: Path) -> None:
    # In the background, the tests and their children may ignore Ctrl-C: the child restores the default handler.
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from coopqp.cli.main import main; sys.exit(main())"
    )
    arguments = ["demo", "--steps", "200000", "--out", str(tmp_path / "new")]
    with subprocess.Popen([sys.executable, "-c", program, *arguments], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            assert process.stderr.readline().startswith("running")
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=60) == 130
        finally:
            process.kill()
        rest = process.stderr.read()
    assert rest == "coopqp: interrupted\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_reader_that_leaves_is_no_error(tmp_path: Path) -> None:
    program = (
        "import sys; from coopqp.cli import main as cli, demo; demo.demo_pictures = lambda *_: {};"
        f"sys.exit(cli.main(['demo', '--steps', '4', '--out', {str(tmp_path)!r}]))"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read().decode()
        assert process.wait(timeout=60) == 0
    assert "Traceback" not in errors
    assert "BrokenPipe" not in errors


def test_an_error_of_several_lines_is_printed_in_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise OutputError("first\n  second")

    monkeypatch.setattr(demo, "run_demo", broken)
    assert cli.main(["demo", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "coopqp: error: first second\n"


def test_ctrl_c_during_the_imports_ends_in_one_line() -> None:
    code = """
import sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "coopqp.cli.main":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from coopqp.cli.start import main
sys.exit(main())
"""
    done = python("-c", code)
    assert (done.returncode, done.stderr, done.stdout) == (130, "coopqp: interrupted\n", "")
