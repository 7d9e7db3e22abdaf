"""The commands for single runs: their output and files; bad input gives an error of one line."""

from __future__ import annotations

import copy
import csv
import json
import logging
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from processes import output, python

from coopqp import Recording, load_cell_file, simulate
from coopqp.cli import main as cli, runs
from coopqp.files.cellfile import example_path
from coopqp.simulation import RecordingError, Tolerances, evaluate, read_run
from coopqp.simulation.evaluation.assessment import why
from coopqp.simulation.recording.scene import read_cell
from coopqp.visualization import plots, viewer

SMALL = """
name = "small {name}"
steps = 12
[[arms]]
name = "a"
robot = "arm7"
[grasp]
kind = "latched"
[path]
kind = "line"
start = {{ xyz_m = [0.5, 0, 0.5] }}
displacement = {{ translation_m = [0, 0, 0.02] }}
duration_s = 0.6
[start]
positions_deg.a = [0, 23, 0, 122, 0, -55, 0]
{more}
"""


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(SMALL.format(name="run", more=""))
    return file


@pytest.fixture(scope="module")
def recording_file(baseline: Callable[..., Recording], tmp_path_factory: pytest.TempPathFactory) -> Path:
    recording = replace(baseline(40), metadata=copy.deepcopy(baseline(40).metadata))
    for arm in recording.metadata["scene"]["arms"]:
        arm["shapes"] = []  # pictures take long
    return recording.save(tmp_path_factory.mktemp("recordings") / "run.npz")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in a temporary folder: commands write into the working directory."""
    monkeypatch.chdir(tmp_path)


def written(text: str) -> list[str]:
    return [line.strip() for line in text.split("written:\n")[1].splitlines()]


# -- run -----------------------------------------------------------------------------------------------------------


def test_run_prints_figures_and_verdict(cell_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", str(cell_file)]) == 0
    printed = capsys.readouterr()
    assert "largest ε_p" in printed.out
    assert "yes  Did the object arrive? 0.6 s for a path of 0.6 s" in printed.out
    assert written(printed.out) == ["out/small_run/recording.npz"]
    assert printed.err.splitlines() == ["running small run"]
    assert "\033" not in printed.out + printed.err
    assert Recording.load(tmp_path / "out" / "small_run" / "recording.npz").n_steps == 12


@pytest.mark.slow
def test_run_writes_what_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    draw = plots.render
    monkeypatch.setattr(plots, "render", lambda scene, view, *, width: draw(scene, view, width=min(width, 60)))
    file = tmp_path / "asks.toml"
    file.write_text(SMALL.format(name="b", more='[output]\nfolder = "here"\nrecording = false\ncsv = true'))
    assert cli.main(["run", str(file), "--bag", "--page", "--report", "--plots"]) == 0
    names = {"report.html", "timeline.png", "joints.png", "motion.png", "view.html", "run.csv", "bag"}
    assert {Path(f).name for f in written(capsys.readouterr().out)} == names
    assert {f.name for f in (tmp_path / "here").iterdir()} == names
    assert cli.main(["run", str(file), "--out", "other", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert [f.name for f in (tmp_path / "other").iterdir()] == ["run.csv"]


@pytest.mark.slow
def test_the_papers_file_prints_the_papers_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = example_path("paper_lift").read_text().replace('kind = "qp"', 'kind = "pseudo_inverse"')
    (tmp_path / "paper.toml").write_text(text.replace("report = true", ""))
    assert cli.main(["run", "paper.toml", "--out", "paper"]) == 4
    printed = capsys.readouterr()
    assert "largest ε_p              0.871 mm" in printed.out
    assert "NO   Do the arms agree" in printed.out
    last = printed.err.splitlines()[-2]
    assert re.fullmatch(
        r"coopqp: failed: Do the arms agree on where the object is\? No: arms \w+ and \w+, beyond the tolerance since "
        r"\d\.\d{3} s\.",
        last,
    )


# -- the exit status -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("product", list(runs.PRODUCTS))
def test_the_folder_has_the_name_of_the_run_whatever_is_written(product: str) -> None:
    assert runs.output_folder("mine", None, ["recording", product], out=None, force=False) == Path("out/mine")


@pytest.mark.parametrize("link", ["out", "out/small_run", "out/small_run-2"])
def test_no_link_leads_a_run_out_of_the_working_directory(
    link: str, cell_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor a link that leads nowhere, nor one in a circle; --out takes any folder."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    Path(link).parent.mkdir(exist_ok=True)
    if link.endswith("-2"):
        Path("out/small_run").mkdir()
        Path("out/small_run/recording.npz").write_bytes(b"")
    victim = tmp_path / "victim"
    for there, target in ((True, victim), (False, tmp_path / "nowhere"), (False, Path(link).name)):
        if there:
            victim.mkdir()
        Path(link).symlink_to(target)
        assert cli.main(["run", str(cell_file), "--quiet"]) == 2
        assert "--out" in capsys.readouterr().err
        Path(link).unlink()
    assert not any(victim.iterdir())
    assert not (tmp_path / "nowhere").exists()
    Path(link).symlink_to(victim)
    assert cli.main(["run", str(cell_file), "--quiet", "--out", "../victim"]) == 0
    (here / "inside").mkdir()
    assert runs.output_folder("x", "inside", ["recording"], out=None, force=False) == Path("inside")


#: Changes of the small cell, and the last line of its run: why, where (arm, joint, limit) and since when.
FAILURES = {
    "blocked at a joint limit": (
        ("translation_m = [0, 0, 0.02]", "translation_m = [0, 0, 0.2]"),
        (
            'robot = "arm7"',
            'robot = "arm7"\nlimits = { upper_deg = [2, 25, 2, 124, 2, -53, 2] }',
        ),
        r"Did the object arrive\? No: blocked since \d\.\d{3} s by arm a joint joint_\d: position.*",
    ),
    "too slow for the longest time": (
        ("duration_s = 0.6", "duration_s = 0.6\ntime_law = 'linear'"),
        ('robot = "arm7"', 'robot = "arm7"\nlimits = { velocity_deg_per_s = 0.1 }'),
        r"Did the object arrive\? No: slowed since 0\.000 s by arm a joint joint_\d: velocity.*",
    ),
}


@pytest.mark.parametrize("case", sorted(FAILURES))
def test_a_run_that_fails_says_why_where_and_since_when(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    *changes, message = FAILURES[case]
    text = SMALL.format(name="fails", more="")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    Path("fails.toml").write_text(text, encoding="utf-8")
    for extra in ([], ["--quiet"]):
        assert cli.main(["run", "fails.toml", "--out", f"out{len(extra)}", *extra]) == 4
        last = capsys.readouterr().err.splitlines()[-1]
        assert re.fullmatch(f"coopqp: failed: {message}", last), last
    recording = Recording.load("out0/recording.npz")  # the report says the same
    cell = read_cell(recording.metadata)
    assert last == f"coopqp: failed: {why(evaluate(cell, recording, read_run(cell, recording)))[-1]}"


def test_the_file_sets_the_tolerances(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The verdict of the command, and later that of the report, use the tolerances of the file."""
    text = SMALL.format(name="strict", more="[verdict]\nobject_mm = 1e-15")
    Path("strict.toml").write_text(text, encoding="utf-8")
    assert cli.main(["run", "strict.toml", "--out", "strict"]) == 4
    printed = capsys.readouterr()
    assert "(asked: 1e-15 mm, 0.5°)" in printed.out
    assert "the object at arm a, beyond the tolerance since 0." in printed.err
    recording = Recording.load("strict/recording.npz")
    assert Tolerances.of(recording) == Tolerances(object_mm=1e-15)
    recording.metadata["settings"]["verdict"] = {"object_mm": "no"}
    with pytest.raises(RecordingError, match="'verdict' in the recording's settings is damaged"):
        Tolerances.of(recording)


def test_blocked_runs_end_after_the_same_while_in_files_and_programs() -> None:
    """A stopped object ends a run after one second, unless another time is given."""
    old, new = FAILURES["blocked at a joint limit"][:2]
    text = SMALL.format(name="waits", more="").replace(*old).replace(*new)
    Path("waits.toml").write_text(text, encoding="utf-8")
    task = load_cell_file("waits.toml")
    ends = [task.run(), simulate(task.controller(), q_start=task.scenario.q_start)]
    stood = [run.time[-1] - run.time[np.flatnonzero(run.status < 2)[-1] + 1] for run in ends]
    assert stood == pytest.approx([1.0, 1.0], abs=task.scenario.dt)


@pytest.mark.slow
def test_ctrl_c_during_the_imports_is_an_interrupt(cell_file: Path) -> None:
    """Whichever import is interrupted, the status is 130 and nothing else is printed."""
    code = (
        "import sys\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == {module!r}: raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "from coopqp.cli.main import main\n"
        "sys.exit(main(['run', {cell!r}]))"
    )
    for module in ("numpy", "pinocchio", "coopqp.simulation.evaluation.assessment", "pydantic"):
        program = code.format(module=module, cell=str(cell_file))
        done = python("-c", program)
        assert (done.returncode, done.stdout, done.stderr) == (130, "", "coopqp: interrupted\n"), module


def test_a_terminal_gets_colours_and_a_bar(
    cell_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for stream in ("stdout", "stderr"):
        monkeypatch.setattr(f"sys.{stream}.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert cli.main(["run", str(cell_file)]) == 0
    printed = capsys.readouterr()
    assert "\033[32myes\033[0m" in printed.out
    assert "%" in printed.err
    monkeypatch.setenv("NO_COLOR", "1")
    assert cli.main(["run", str(cell_file)]) == 0
    assert "\033" not in capsys.readouterr().out


# -- schema --------------------------------------------------------------------------------------------------------


def test_schema_is_printed_for_people_and_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["schema"]) == 0
    assert "[[arms]]" in capsys.readouterr().out
    assert cli.main(["schema", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "CellFile"
    assert cli.main(["schema", "--example"]) == 0
    assert capsys.readouterr().out == example_path("paper_lift").read_text()
    assert cli.main(["schema", "--example", "paper_baseline"]) == 0
    assert capsys.readouterr().out == example_path("paper_baseline").read_text()


# -- view, report, export ------------------------------------------------------------------------------------------


def test_view_writes_a_page(recording_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["view", str(recording_file), "--html", "new/view.html"]) == 0
    assert written(capsys.readouterr().out) == ["new/view.html"]
    assert "PseudoInverseController, 40 steps" in (tmp_path / "new" / "view.html").read_text()


def test_view_serves_until_interrupted(
    recording_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)

    def interrupt(self: viewer.LiveViewer) -> None:
        assert self.update(0.5) > 0
        raise KeyboardInterrupt

    monkeypatch.setattr(viewer.LiveViewer, "run", interrupt)
    assert cli.main(["view", str(recording_file), "--port", "0"]) == 0
    assert opened[0].startswith("http://127.0.0.1:")
    assert opened[0] in capsys.readouterr().out
    assert cli.main(["view", str(recording_file), "--port", "0", "--no-open", "--sticks", "--quiet"]) == 0
    assert len(opened) == 1
    assert capsys.readouterr().out == ""


def test_run_can_end_in_the_viewer(cell_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[int] = []
    monkeypatch.setattr("coopqp.cli.commands._serve", lambda recording, **_: served.append(recording.n_steps))
    assert cli.main(["run", str(cell_file), "--view", "--quiet"]) == 0
    assert served == [12]


@pytest.mark.slow
def test_report_lies_beside_the_recording(recording_file: Path, tmp_path: Path) -> None:
    assert cli.main(["report", str(recording_file), "--quiet"]) == 0
    page = recording_file.with_name("run_report.html").read_text()
    assert "(asked: 0.1 mm, 0.1°)" in page
    assert cli.main(["report", str(recording_file), "--out", "r.html", "--chain-mm", "50", "--quiet"]) == 0
    assert "(asked: 50 mm, 0.1°)" in (tmp_path / "r.html").read_text()


def test_pages_and_tables_are_overwritten_with_force_only(
    recording_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is named and exists is refused before any work; a report without a name gets a number."""
    monkeypatch.setattr("coopqp.visualization.report.report_html", lambda *_, **__: "new")
    what = str(tmp_path / "lift.npz")
    Path(what).write_bytes(recording_file.read_bytes())
    for name, command in {
        "r.html": ["report", what, "--out", "r.html"],
        "v.html": ["view", what, "--html", "v.html"],
        "run.csv": ["export", what, "--csv", "run.csv"],
        "demo/figure5.png": ["demo", "--steps", "4", "--out", "demo"],
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("mine")
        assert cli.main([*command, "--quiet"]) == 2
        assert f"{name} exists. Replace it with --force" in capsys.readouterr().err
        assert (tmp_path / name).read_text() == "mine"
    for name in ("r.html", "v.html", "run.csv"):
        kind = {"r.html": ["report", what, "--out"], "v.html": ["view", what, "--html"]}.get(name)
        assert cli.main([*(kind or ["export", what, "--csv"]), name, "--quiet", "--force"]) == 0
        assert (tmp_path / name).read_text() != "mine"
    for _ in range(2):
        assert cli.main(["report", what, "--quiet"]) == 0
    assert {f.name for f in tmp_path.glob("lift_*")} == {"lift_report.html", "lift_report-2.html"}


def test_export_writes_every_kind(recording_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    what = str(recording_file)
    assert cli.main(["export", what, "--csv", "a/run.csv", "--bag", "bag", "--npz", "b/run.npz"]) == 0
    assert written(capsys.readouterr().out) == ["b/run.npz", "a/run.csv", "bag"]
    assert (tmp_path / "bag" / "bag.mcap").is_file()
    again = Recording.load(tmp_path / "b" / "run.npz")
    np.testing.assert_array_equal(again.q, Recording.load(recording_file).q)
    assert cli.main(["export", what, "--csv", "-"]) == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert len(rows) == 41


@pytest.mark.slow
def test_runs_come_from_recordings_cell_files_and_scenarios(cell_file: Path, recording_file: Path) -> None:
    assert runs.obtain_run(str(recording_file)).n_steps == 40
    assert runs.obtain_run(str(cell_file)).n_steps == 12
    told: list[int] = []
    recording = runs.obtain_run("paper_lift", progress=lambda done, total: told.append(done))
    assert recording.metadata["scenario"] == "paper_lift"
    assert recording.metadata["object"]["size_m"] == [0.8, pytest.approx(1.8), 0.04]
    assert told == list(range(1, 401))


# -- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run"], "CELL"),
        (["run", "none.toml"], "cannot read none.toml: No such file"),
        (["run", "{cell}", "--out", "{cell}"], "is a file, not a folder"),
        (["view", "papre_lift"], "Did you mean 'paper_lift'?"),
        (["view", "{cell}x"], "no recording (.npz), cell file (.toml, .yaml) or scenario"),
        (["view", "none.npz"], "cannot read none.npz: there is no such file"),
        (["view", "{recording}", "--html", "."], "it is a folder"),
        (["view", "{recording}", "--port", "99999", "--no-open"], "port is 99999"),
        (["view", "{recording}", "--port", "x"], "--port"),
        (["report", "{recording}", "--out", "."], "it is a folder"),
        (["report", "{recording}", "--chain-mm", "-1"], "Tolerances: chain_mm: -1"),
        (["export", "{recording}"], "nothing to write: give --csv, --bag or --npz"),
        (["export", "{recording}", "--bag", "."], "it exists"),
        (["export", "{recording}", "--csv", "{cell}/x.csv"], "is a file, not a folder"),
        (["schema", "--yaml"], "--yaml"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], message: str, cell_file: Path, recording_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"cell": str(cell_file), "recording": str(recording_file)}
    assert cli.main([argument.format(**names) for argument in arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    *progress, error = printed.err.splitlines()
    assert error.startswith("coopqp: error:")
    assert message in error
    assert all(line.startswith("running") for line in progress)


def test_a_recording_without_a_scene_says_so(recording_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = Recording.load(recording_file)
    recording.metadata.pop("scene")
    recording.save("bare.npz")
    for command in (["view", "bare.npz", "--no-open"], ["report", "bare.npz"], ["export", "bare.npz", "--csv", "x"]):
        assert cli.main(command) == 2
        assert "does not describe its cell" in capsys.readouterr().err


def test_products_that_do_not_exist_are_named(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="Did you mean 'report'"):
        runs.output_folder("run", None, ["reprot"], out=None, force=False)


@pytest.mark.slow
def test_nothing_is_overwritten_unless_it_is_asked_for(cell_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Runs go into fresh numbered folders; a folder of --out that is used needs --force, and so does a recording."""
    for folder in ("out/small_run", "out/small_run-2", "out/small_run-3"):
        assert cli.main(["run", str(cell_file)]) == 0
        assert written(capsys.readouterr().out) == [f"{folder}/recording.npz"]
    assert cli.main(["run", str(cell_file), "--out", "out/small_run"]) == 2
    assert "out/small_run/recording.npz exists. Replace it with --force" in capsys.readouterr().err
    assert cli.main(["run", str(cell_file), "--force"]) == 0
    assert written(capsys.readouterr().out) == ["out/small_run/recording.npz"]
    assert len(list(Path("out").iterdir())) == 3
    assert cli.main(["run", str(cell_file), "--out", "b", "--bag", "--quiet"]) == 0
    assert cli.main(["run", str(cell_file), "--out", "b", "--bag", "--quiet", "--force"]) == 0
    (Path("b") / "bag" / "mine.txt").write_text("not a file of a bag")
    assert cli.main(["run", str(cell_file), "--out", "b", "--bag", "--quiet", "--force"]) == 2
    assert "is no bag of coopqp and was not replaced" in capsys.readouterr().err
    export = ["export", "out/small_run/recording.npz", "--quiet", "--npz", "again.npz"]
    assert [cli.main(export), cli.main(export), cli.main([*export, "--force"])] == [0, 2, 0]


@pytest.mark.parametrize("folder", ["/tmp/x", "../x", "a/../../x", "C:/x", "~/x", "$HOME/x", "a\\\\..\\\\x"])
def test_a_file_writes_below_the_working_directory_only(folder: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("away.toml").write_text(SMALL.format(name="away", more=f'[output]\nfolder = "{folder}"'))
    assert cli.main(["run", "away.toml"]) == 2
    assert "output.folder: give a folder below the working directory" in capsys.readouterr().err


@pytest.mark.slow
def test_an_interrupt_leaves_no_partial_file_and_no_empty_folder(
    cell_file: Path, recording_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever file is being written."""
    before = set(Path().rglob("*"))
    commands = {
        "coopqp.output.temporary_name": ["report", str(recording_file), "--out", "a/b/report.html"],
        "coopqp.simulation.recording.recording.write_archive": ["run", str(cell_file), "--out", "a/b"],
        "coopqp.files.export._rename_inside": ["export", str(recording_file), "--bag", "c/d/bag"],
        "pathlib.Path.replace": ["export", str(recording_file), "--csv", "c/d/run.csv"],
    }
    for place, command in commands.items():
        with monkeypatch.context() as patched:
            patched.setattr(place, _interrupt)
            assert cli.main(command) == 130, command
        assert set(Path().rglob("*")) == before, command


def _interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("text", ["\x1b[2Jred", "a\u202eb", "a\x07", "two\nlines"])
def test_control_characters_reach_no_terminal(
    text: str, recording_file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Neither from a cell file nor from the recording of a stranger."""
    escaped = json.dumps(text)[1:-1].replace("\x07", "\\u0007")
    Path("odd.toml").write_text(SMALL.format(name=escaped, more=""), encoding="utf-8")
    assert cli.main(["run", "odd.toml"]) == 2
    printed = capfd.readouterr().err
    assert "name: " in printed
    assert "has control characters" in printed
    for name in ("robot", "urdf"):
        Path("odd.toml").write_text(SMALL.format(name="x", more="").replace('robot = "arm7"', f'{name} = "{escaped}"'))
        assert cli.main(["run", "odd.toml"]) == 2
        printed += capfd.readouterr().err
    recording = Recording.load(recording_file)
    recording.metadata["scenario"] = text
    recording.metadata["scene"]["arms"][0]["joints"][0]["name"] = text
    recording.save("odd.npz")
    cli.main(["view", text])
    cli.main(["export", "odd.npz", "--csv", "-"])
    printed += "".join(capfd.readouterr())
    assert text not in printed
    assert not set(printed) & {"\x1b", "\u202e", "\x07"}


def test_no_cell_of_a_table_is_a_formula(tmp_path: Path) -> None:
    text = SMALL.format(name="x", more="").replace('"a"', '"=cmd()"').replace("deg.a", 'deg."=cmd()"')
    Path("cell.toml").write_text(text)
    assert cli.main(["run", "cell.toml", "--csv", "--quiet"]) == 0
    rows = list(csv.reader(Path("out/small_x/run.csv").read_text().splitlines()))
    assert "'=cmd()/joint_1.position_rad" in rows[0]
    for cell in (cell for row in rows for cell in row):
        assert re.fullmatch(r"-?\d.*", cell) or not cell.startswith(("=", "+", "-", "@", "\t", "\r")), cell


@pytest.mark.parametrize(("name", "folder"), [("paper lift", "paper_lift"), ("../../etc", "_.._etc"), ("a/b", "a_b")])
def test_names_cannot_leave_the_folder(name: str, folder: str) -> None:
    assert runs.safe_name(name) == folder


def test_a_name_of_dots_is_refused() -> None:
    with pytest.raises(Exception, match="makes no name"):
        runs.safe_name("..")


# -- the library is quiet ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_library_attaches_no_log_handler() -> None:
    code = (
        "import logging; import coopqp.cli.runs, coopqp.visualization.report, coopqp.files.export;"
        "import coopqp.visualization.viewer, coopqp.files.cellfile.build;"
        "names = [n for n in logging.root.manager.loggerDict if n.startswith('coopqp')];"
        "assert not logging.root.handlers, logging.root.handlers;"
        "assert not any(logging.getLogger(n).handlers for n in names), names"
    )
    done = python("-c", code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert not any(handler.__class__.__module__.startswith("coopqp") for handler in logging.root.handlers)


def test_only_what_is_used_is_imported() -> None:
    """`coopqp --help` needs no extra."""
    code = (
        "import sys; from coopqp.cli.main import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "heavy = [m for m in ('viser', 'rosbags', 'pydantic', 'matplotlib', 'rich') if m in sys.modules]\n"
        "assert not heavy, heavy"
    )
    output("-c", code)
