"""The pages in docs/ are true: every example prints the output on its page, and the pages build without warnings."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import sys
from pathlib import Path

import pytest
from apart import run_apart
from coopqp.core._core import RECOVERY_SHARE
from listings import LISTING, listing
from pictures import MOST_PIXELS, PROGRAMS, difference, drawn_alike
from places import ROOT

import coopqp

DOCS = ROOT / "docs"
EXAMPLES = sorted((DOCS / "examples").glob("[0-9][0-9]_*.py"))
#: The step of the derivations, which draws nothing.
THE_STEP = DOCS / "examples" / "the_step.py"
PAGES = sorted(p for p in DOCS.rglob("*.md") if "_build" not in p.parts)
#: An example that a page shows, and the output below it.
SHOWN = re.compile(
    r"<!-- listing: (\S+\.py) -->\n```python\n.*?^```\n(?:(?!```)[^\n]*\n)*?```text\n(.*?)^```$", re.M | re.S
)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
#: Figures below this are rounding and differ between machines.
ROUNDING = 1e-3
TIMES = "µs"


def test_examples_are_numbered_short_and_shown() -> None:
    assert [file.name[:2] for file in EXAMPLES] == [f"{i:02d}" for i in range(1, len(EXAMPLES) + 1)]
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    for file in EXAMPLES:
        source = file.read_text(encoding="utf-8")
        assert len(source.partition('if "--out"')[0].splitlines()) <= 82, file.name
        assert f"python docs/examples/{file.name}" in source
        assert f"examples/{file.name}" in text


def test_the_pages_have_a_bounded_number_of_words() -> None:
    """Outside of code and output: who adds a page takes something out."""
    prose = (re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S) for page in PAGES)
    assert sum(len(text.split()) for text in prose) <= 45_000


def test_programs_and_files_stand_in_the_pages_as_they_are() -> None:
    """A reader of the repository sees them there. After a change of one: python docs/listings.py."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert LISTING.sub(listing, text) == text, page.name
        assert "{literalinclude}" not in text, page.name
        assert text.count("<!-- listing:") == len(LISTING.findall(text)), page.name


@pytest.mark.slow
def test_the_step_at_its_shortest_is_the_controllers(tmp_path: Path) -> None:
    assert len(THE_STEP.read_text(encoding="utf-8").splitlines()) <= 150
    printed = run_apart(THE_STEP, folder=ROOT, printed=tmp_path / "printed.txt")
    page = (DOCS / "derivations.md").read_text(encoding="utf-8")
    ((_, shown),) = [found for found in SHOWN.findall(page) if Path(found[0]).name == THE_STEP.name]
    assert printed == shown


def the_papers_errors_are_those_of_the_derivations(printed: str) -> None:
    found = re.findall(r"N = (\d+): paper (\S+) mm, QP (\S+) mm", printed)
    assert [int(n) for n, _, _ in found] == [40, 400, 1000]
    for (_, paper, qp), expected, at_most in zip(found, (8.70, 0.871, 0.348), (1.0e-4, 9.4e-7, 6.0e-8), strict=True):
        assert float(paper) == pytest.approx(expected, rel=0.01)
        assert float(qp) == pytest.approx(at_most, rel=0.1)


def the_run_is_judged_well(printed: str) -> None:
    assert all(line.startswith("yes ") for line in printed.splitlines())


def every_cell_is_proved_and_runs(printed: str) -> None:
    assert len(printed.splitlines()) == 4
    assert all(line.endswith("CERTIFIED, finished True, all checks hold: True") for line in printed.splitlines())


#: What else holds of the output of an example.
FURTHER = {
    "01_paper_lift": the_papers_errors_are_those_of_the_derivations,
    "02_your_own_arms": the_run_is_judged_well,
    "21_four_cells": every_cell_is_proved_and_runs,
}


@pytest.mark.slow
@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_an_example_prints_and_draws_what_the_pages_show(file: Path, tmp_path: Path) -> None:
    program = f"python docs/examples/{file.name} --out {{out}}"
    printed = run_apart(file, "--out", str(tmp_path), folder=ROOT, printed=tmp_path / "printed.txt")
    assert printed.strip()
    same_engine = drawn_alike() or "Physics" not in file.read_text(encoding="utf-8")
    for page in PAGES:
        for include, shown in SHOWN.findall(page.read_text(encoding="utf-8")):
            if Path(include).name == file.name:
                compare(shown, printed, page.name, numbers=same_engine)
    FURTHER.get(file.stem, str)(printed)
    for picture in PROGRAMS.get(program, ()):
        drawn = tmp_path / Path(picture).name
        assert drawn.is_file()
        assert not drawn_alike() or difference(ROOT / picture, drawn) <= MOST_PIXELS, picture


def compare(shown: str, printed: str, page: str, *, numbers: bool = True) -> None:
    """What a page shows and what an example prints are the same, up to the rounding of another machine.

    Without ``numbers`` the words alone: another version of the engine squeezes by other newtons.
    """
    for said, line in zip(shown.splitlines(), printed.splitlines(), strict=False):
        assert NUMBER.sub("#", said).split() == NUMBER.sub("#", line).split(), f"{page}: {line}"
        if TIMES in said or not numbers:
            continue
        for a, b in zip(map(float, NUMBER.findall(said)), map(float, NUMBER.findall(line)), strict=True):
            assert abs(a - b) <= 0.05 * abs(a) or max(abs(a), abs(b)) < ROUNDING, f"{page}: {line}"
    assert len(printed.splitlines()) - len(shown.splitlines()) in (0, 1)  # a last line of times may be left out


def test_each_tutorial_and_how_to_shows_a_picture() -> None:
    for page in (DOCS / "index.md", *DOCS.glob("tutorials/*.md"), *DOCS.glob("howto/*.md")):
        assert re.search(r"!\[[^\]]{20,}\]\([^)]+\.(png|gif)\)", page.read_text(encoding="utf-8")), page.name


def test_the_reference_has_every_public_name() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md"))
    named = set(re.findall(r"(?:auto(?:class|function|exception)|py:data):: coopqp\.(\w+)$", text, flags=re.M))
    assert named == set(coopqp.__all__) - {"__version__"}


def test_notation_and_code_agree() -> None:
    """A_k v = blockdiag(Rᵀ, Rᵀ) J_k v, J_k about R's origin, is the derivative of e_k for any grasp."""
    import numpy as np
    import pinocchio as pin

    from coopqp.model.chain import Chain
    from coopqp.scenarios import paper_lift

    lift = paper_lift()
    chain, rng, h = Chain(lift.cell, lift.grasp), np.random.default_rng(1), 1e-6
    q, v, R = lift.q_start, rng.standard_normal(lift.cell.nv), lift.path.pose(0.0)
    chain.linearise(q, about=R.translation)
    A_v = (chain.twists(v).reshape(-1, 2, 3) @ R.rotation).reshape(-1, 6)
    ends = [chain.errors(chain.carried(pin.integrate(lift.cell.model, q, s * h * v)), R) for s in (-1.0, 1.0)]
    np.testing.assert_allclose((ends[1] - ends[0]) / (2.0 * h), A_v, atol=1e-7)


def test_every_file_of_the_core_stands_in_the_table_of_ideas() -> None:
    text = (DOCS / "derivations.md").read_text(encoding="utf-8")
    table = text.partition("(files)=")[2].partition("\n## Rows of constraints")[0]
    named = {name for row in table.splitlines() if row.startswith("|") for name in re.findall(r"`(.+?)`", row)}
    core = ROOT / "coopqp" / "core"
    assert len(named) >= 25
    if core.is_dir() and any(core.glob("*.cpp")):  # a wheel has no C++
        assert [name for name in sorted(named) if not (core / name).is_file()] == []


def test_defaults_in_the_text_are_those_of_the_code() -> None:
    """After a change of a default, also change the pages: howto/gains, howto/why-slow, derivations, tutorials 2 and 5,
    reliability."""
    from coopqp.solvers import OsqpSettings

    assert (RECOVERY_SHARE, OsqpSettings().max_iter) == (0.2, 20000)
    o = coopqp.QPOptions()
    s, w, p = o.supervision, o.weights, coopqp.PreviewOptions()
    assert (o.grasp_gain, o.path_gain, o.correction_speed, o.correction_spin) == (20.0, 20.0, 0.1, 0.4)
    assert (o.measurement_time, o.solver, o.common_error.kind) == (0.02, "auto", "leader")
    assert (o.blocked_rate, s.joint_jump, s.stall_samples) == (1e-3, 0.3, 4)
    assert (s.slow_from, s.hold_from, s.fault_from, s.dt_range) == (0.00025, 0.00075, 0.02, (0.1, 5.0))
    assert (w.chain, w.recovery, w.off_path, w.grasp, w.path, w.rate, w.posture) == (1e8, 1e6, 1e4, 1, 1e-2, 1e-4, 1e-6)
    assert (w.length, p.rate_slope, p.margin, p.curvature_share) == (0.3, 10.0, 0.95, 0.5)


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\((?!https?://|#)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


@pytest.mark.slow
def test_view_needs_nothing_but_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """``--view`` opens the viewer on the run; the test closes it at once."""
    from coopqp.visualization import viewer

    opened = []
    monkeypatch.setattr(viewer.LiveViewer, "run", lambda self: opened.append(self.url))
    monkeypatch.setattr(sys, "argv", ["02_your_own_arms.py", "--view"])
    with contextlib.redirect_stdout(io.StringIO()) as out:
        runpy.run_path(str(DOCS / "examples" / "02_your_own_arms.py"), run_name="__main__")
    assert opened
    assert f"Open {opened[0]}" in out.getvalue()
