"""Every sentence of what SECURITY.md promises has tests, which are named here; and two that stand nowhere else."""

from __future__ import annotations

import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import pytest
from places import ROOT

from coopqp import Recording
from coopqp.files.cellfile.text import MAX_FILE_BYTES, read_tables
from coopqp.model.description import MAX_DESCRIPTION_BYTES
from coopqp.model.tool_guess import guess_tool
from coopqp.visualization import write_report
from coopqp.visualization.viewer import export_html

#: The sentences of the part "What is promised" and of those after it that promise something, each with its tests.
TESTS = {
    "Robot descriptions, cell files and recordings may come from strangers.": (
        "tests/reliability/test_loading.py::test_files_that_mean_no_good",
        "tests/reliability/test_damaged_files.py::test_damaged_files_end_in_a_result_or_a_named_error",
    ),
    "Reading them executes nothing in them.": (
        "tests/reliability/test_loading.py::test_files_that_mean_no_good",
        "tests/files/test_cellfile.py::test_reading_a_file_imports_and_runs_nothing_else",
    ),
    "Sizes are bounded, and errors are named.": (
        "tests/files/test_cellfile.py::test_missing_and_huge_files_are_refused",
        "tests/collision/test_collision.py::test_empty_and_huge_meshes_are_refused",
        "tests/project/test_security.py::test_files_beyond_their_bounds_are_refused_by_name",
        "tests/reliability/test_strangers_files.py::test_what_is_nested_deep_is_refused_by_name",
        "tests/reliability/test_strangers_files.py::test_endless_names_make_short_messages",
    ),
    "A device, a pipe or a folder in place of a file is refused, and not waited for.": (
        "tests/reliability/test_strangers_files.py::test_what_is_no_ordinary_file_is_refused_by_every_reader",
    ),
    "A cell file writes below the working directory only, and no link leads out of it.": (
        "tests/cli/test_commands.py::test_no_link_leads_a_run_out_of_the_working_directory",
        "tests/cli/test_commands.py::test_names_cannot_leave_the_folder",
    ),
    "A recording names mesh files.": ("tests/simulation/test_scene.py::test_a_mesh_is_read_from_its_file",),
    "They are opened only if you ask for it (`--meshes`, `Recording.load(file, meshes=True)`).": (
        "tests/simulation/test_scene.py::test_a_recording_from_a_file_opens_no_mesh_unless_asked",
    ),
    "Names from files reach a terminal, a table, a picture or a page only as text: control characters are escaped, "
    "cells of a CSV table begin no formula, and pages run no script from a name.": (
        "tests/cli/test_commands.py::test_control_characters_reach_no_terminal",
        "tests/cli/test_commands.py::test_no_cell_of_a_table_is_a_formula",
        "tests/visualization/test_notebook.py::test_names_are_escaped",
        "tests/cli/test_new.py::test_names_of_a_strangers_file_stay_names",
        "tests/visualization/test_plots.py::test_names_are_text_and_no_formulas",
    ),
    "The viewer listens on this machine only.": (
        "tests/visualization/test_viewer.py::test_it_listens_on_this_machine_alone",
    ),
    "It refuses requests with a foreign `Host` or `Origin`.": (
        "tests/visualization/test_viewer.py::test_foreign_pages_get_nothing",
    ),
    "Its address has a key, which is new for each run, and without which it answers no program.": (
        "tests/visualization/test_viewer.py::test_the_page_is_for_those_who_know_its_key",
        "tests/visualization/test_viewer.py::test_the_run_is_sent_to_its_own_page_only",
    ),
    "No page may show it in a frame.": ("tests/visualization/test_viewer.py::test_foreign_pages_get_nothing",),
    "The operator's page (`coopqp jog`) does so, too.": (
        "tests/visualization/test_jog_page.py::test_foreign_pages_get_neither_script_nor_socket",
    ),
    "It takes commands from the leading page alone.": (
        "tests/visualization/test_jog_page.py::test_keys_lead_from_the_leading_page_alone",
        "tests/browser/test_jog_page.py::test_an_operator_leads_the_object",
    ),
    "A driver and its robot's process speak over sockets that have neither port nor name.": (
        "tests/drivers/test_sim.py::test_no_other_process_can_reach_a_robot_or_its_driver",
    ),
    "Other processes of a run share memory that has no name.": (
        "tests/drivers/test_bag_recorder.py::test_a_ring_has_no_name_and_is_gone_with_its_processes",
    ),
    "No other program can send or listen there, and a killed run leaves nothing behind.": (
        "tests/drivers/test_sim.py::test_no_other_process_can_reach_a_robot_or_its_driver",
        "tests/drivers/test_bag_recorder.py::test_a_ring_has_no_name_and_is_gone_with_its_processes",
    ),
    "A report and an exported page load nothing from elsewhere.": (
        "tests/project/test_security.py::test_pages_name_nothing_elsewhere_to_be_loaded",
        "tests/browser/test_report_page.py::test_the_report_opens_offline",
        "tests/browser/test_viewer_page.py::test_the_page_plays_offline",
    ),
    "Keep it in a network of your own, or use TLS: `tls://` with `Cluster(address, security=…)`, or with the "
    "certificates of Dask's settings (`DASK_DISTRIBUTED__COMM__TLS__CA_FILE` and others), which the command uses, "
    "too.": ("tests/studies/test_studies.py::test_tls_is_passed_on_to_dask",),
    "It keeps limits and the distances between arms in its commands.": (
        "tests/reliability/test_stopping.py::test_the_controllers_own_commands_stop_inside",
        "tests/collision/test_collision.py::test_arms_evade_each_other",
    ),
}
#: Sentences that promise nothing that a test could show, by their beginnings.
SAID = (
    "`tests/project/test_security.py`", "A program is trusted", "The address of a Dask scheduler", "Rows and results",
    "A ROS 2 domain is as trusted", "Keep it to this machine",
    "coopqp is no safety controller", "Stopping a robot", "Please report", "Give the file", "You get an answer",
    "The newest release",
)  # fmt: skip


def sentences() -> list[str]:
    """The sentences of SECURITY.md, without headings and marks of lists."""
    text = re.sub(r"^#.*$", "\n", (ROOT / "SECURITY.md").read_text(encoding="utf-8"), flags=re.M)
    blocks = [" ".join(block.split()).removeprefix("- ") for block in re.split(r"\n\s*\n|\n(?=- )", text)]
    return [sentence for block in blocks if block for sentence in re.split(r"(?<=\.)\s+(?=[A-Z`])", block)]


def test_each_sentence_is_shown_by_tests_that_exist() -> None:
    promised = [sentence for sentence in sentences() if not sentence.startswith(SAID)]
    assert promised == list(TESTS)
    for tests in TESTS.values():
        for test in tests:
            file, _, name = test.partition("::")
            assert re.search(rf"^def {name}\(", (ROOT / file).read_text(encoding="utf-8"), re.M), test


def test_files_beyond_their_bounds_are_refused_by_name(tmp_path: Path) -> None:
    for name, size, read in (
        ("cell.toml", MAX_FILE_BYTES, read_tables),
        ("arm.urdf", MAX_DESCRIPTION_BYTES, guess_tool),
    ):
        file = tmp_path / name
        with file.open("wb") as stream:
            stream.truncate(size + 1)
        with pytest.raises(Exception, match=f"{name}.* larger than {size} bytes"):
            read(file)


class _Loads(HTMLParser):
    """The addresses that a page would load from, without those in its scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "srcset", "data", "poster", "background") or (name == "href" and tag != "a"):
                self.addresses.append(value or "")
            if name == "style":
                self.addresses += re.findall(r"url\(([^)]*)\)", value or "")


@pytest.mark.slow
def test_pages_name_nothing_elsewhere_to_be_loaded(baseline: Callable[..., Recording], tmp_path: Path) -> None:
    """Their scripts are watched in the browser (tests/browser)."""
    run = baseline(40)
    for page in (write_report(run, tmp_path / "report.html"), export_html(run, tmp_path / "page.html", sticks=True)):
        found = _Loads()
        found.feed(page.read_text(encoding="utf-8"))
        assert found.addresses or page.name == "page.html"
        elsewhere = [a for a in found.addresses if not a.strip("'\" ").startswith(("data:", "#", "blob:"))]
        assert elsewhere == [], page.name
