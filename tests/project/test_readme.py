"""The README is true: its program runs, its commands exist, its pictures exist."""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import subprocess
from pathlib import Path

import matplotlib.image
import pytest
from markdown_it import MarkdownIt
from PIL import Image
from places import ROOT

from coopqp.cli import demo, main as cli

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)


COMMANDS = [line for block in blocks("sh") for line in block.splitlines()]


def test_the_program_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = blocks("python")
    assert len(program.splitlines()) <= 16
    exec(compile(program, "README.md", "exec"), {"__name__": "__main__"})
    reason, agreement = capsys.readouterr().out.splitlines()
    assert reason == "The object follows its path."
    match = re.fullmatch(r"The arms agree to (\S+) mm on where the plate is\.", agreement)
    assert match is not None
    assert float(match[1]) < 1e-3


def test_all_commands_are_known() -> None:
    assert [shlex.split(line)[0] for line in COMMANDS] == ["pip", "coopqp", "make", "make", "coopqp"]
    assert set(blocks("[a-z]*")) == {*blocks("sh"), *blocks("python"), *blocks("text")}


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize("line", [line for line in COMMANDS if line.startswith("make")])
def test_make_targets_exist(line: str) -> None:
    command, *arguments = shlex.split(line)
    subprocess.run([command, "--dry-run", *arguments], cwd=ROOT, check=True, capture_output=True)


@pytest.mark.slow
@pytest.mark.parametrize("line", [line for line in COMMANDS if line.startswith("coopqp")])
def test_the_command_lines_run(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "demo_pictures", lambda *_: {"picture.png": b""})  # drawn in test_cli
    _, *arguments = shlex.split(line)
    assert cli.main([*arguments, "--quiet"]) == 0
    assert (tmp_path / "out").is_dir()
    assert (tmp_path / "out" / "records.json").is_file() == ("--json" in arguments)


def test_the_pictures_are_there_and_wide_enough() -> None:
    names = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", README)
    moving = [name for name in names if name.endswith(".gif")]
    pictures = [name for name in names if name not in moving]
    assert (len(moving), len(pictures)) == (3, 1)
    for name in pictures:
        assert matplotlib.image.imread(ROOT / name).shape[1] >= 1000
    for name in moving:
        assert (ROOT / name).stat().st_size <= 3_000_000
        with Image.open(ROOT / name) as film:
            assert film.n_frames > 20
            assert film.width >= 800


def test_released_links_are_absolute() -> None:
    """PyPI has no files beside the README."""
    script = runpy.run_path(str(ROOT / ".ci" / "absolute_links.py"))
    released = script["absolute"](README, "https://host/me/repository", "v1")
    base = r"https://host/me/repository/(raw|blob)/v1/"
    targets = re.findall(rf"\]\({base}([^)]+)\)", released)
    assert {kind for kind, _ in targets} == {"raw", "blob"}
    assert all((ROOT / path).exists() for _, path in targets)
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", released)
    assert pictures
    assert all(re.match(rf"{base}|https://", picture) for picture in pictures)
    assert re.sub(base, "", released) == README


def test_no_link_of_a_released_readme_stays_relative() -> None:
    """As a page shows it: links in tables, pictures in links, footnotes."""
    script = runpy.run_path(str(ROOT / ".ci" / "absolute_links.py"))
    page = MarkdownIt("gfm-like", {"linkify": False}).render(script["absolute"](README, "https://host/r", "v1"))
    targets = re.findall(r'(?:href|src)="([^"]*)"', page)
    assert len(targets) > 4
    assert [t for t in targets if not t.startswith(("https://", "#"))] == []
    odd = "a [b](c.md) [![d](e.png)](f.md) `[g](h.md)` [i](#j)\n```\n[k](l.md)\n```\n"
    rewritten = script["absolute"](odd, "https:R", "v")
    for before, after in (("(c", "(https:R/blob/v/c"), ("(e", "(https:R/raw/v/e"), ("(f", "(https:R/blob/v/f")):
        odd = odd.replace(before, after)
    assert rewritten == odd


def test_the_release_builds_from_the_rewritten_readme() -> None:
    """One source distribution is built, after the links are absolute, and the wheels are built from it."""
    flow = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    rewritten, built = flow.index("python .ci/absolute_links.py"), flow.index("python .ci/release.py sdist dist")
    assert rewritten < built < flow.index("cibuildwheel --output-dir wheels dist/*.tar.gz")
    assert len(re.findall(r"release.py sdist|cibuildwheel --output", flow)) == 2
