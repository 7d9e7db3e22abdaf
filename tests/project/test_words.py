"""Pages, help texts and public docstrings use the words of the glossary, and not those that it has replaced."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator

import pytest
from places import ROOT

from coopqp.cli import main as cli
from coopqp.files import schema_text

PAGES = (ROOT / "README.md", ROOT / "benchmarks" / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
PACKAGES = (
    "coopqp", "coopqp.baselines", "coopqp.collision", "coopqp.constraints", "coopqp.files", "coopqp.forces",
    "coopqp.model", "coopqp.paths", "coopqp.scenarios", "coopqp.simulation", "coopqp.solvers", "coopqp.studies",
    "coopqp.visualization",
)  # fmt: skip
COMMANDS = ("run", "plan", "view", "report", "export", "check", "calibrate", "sensors", "sweep", "place", "demo")
#: Words that the glossary has replaced, and its word. Where other tools or the paper are quoted they stay.
REPLACED = {
    r"knots?": "grid point",
    r"reins": "speed override",
    r"minding": "force monitoring",
    r"efforts?": "ramp time, or seed factor",
    r"(?<!loop )closures?": "loop residual",
    r"wish(?:es)?": "null-space reference",
    r"going over": "retargeting",
    r"rays?": "rate line search",
    r"breach(?:es)?": "violation",
    r"(?:masters?|slaves?)": "leader, follower",
}
#: Texts about the paper's example, whose arms are called master and slave, and about another controller.
QUOTES_THE_PAPER = ("beside.md", "notation.md", "physics.md", "place.md", "benchmarks/README.md", "CommonError",
                    "coopqp.scenarios")  # fmt: skip


def prose_of_pages() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        yield page.relative_to(ROOT).as_posix(), re.sub(r"`[^`]*`|\]\([^)]*\)", "", text)


def prose_of_docstrings() -> Iterator[tuple[str, str]]:
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            thing = getattr(module, name)
            if not (inspect.isclass(thing) or inspect.isfunction(thing)):
                continue
            members = vars(thing).items() if inspect.isclass(thing) else ()
            parts = [thing, *(member for key, member in members if key[0] != "_" and not isinstance(member, str))]
            text = "\n".join(filter(None, (inspect.getdoc(part) for part in parts)))
            yield f"{package}.{name}", re.sub(r"^ *\w[\w, ]*: |``[^`]*``|:\w+:`[^`]*`", "", text, flags=re.M)


def prose_of_commands(capsys: pytest.CaptureFixture[str]) -> Iterator[tuple[str, str]]:
    yield "coopqp schema", schema_text()
    for command in COMMANDS:
        with pytest.raises(SystemExit):
            cli.main([command, "--help"])
        yield f"coopqp {command}", capsys.readouterr().out


def test_texts_use_the_words_of_the_glossary(capsys: pytest.CaptureFixture[str]) -> None:
    found = []
    for place, text in (*prose_of_pages(), *prose_of_docstrings(), *prose_of_commands(capsys)):
        for word, better in REPLACED.items():
            if "master" in word and any(quoted in place for quoted in QUOTES_THE_PAPER):
                continue
            for match in re.finditer(rf"\b{word}\b", text, re.IGNORECASE):
                around = " ".join(text[max(match.start() - 40, 0) : match.end() + 40].split())
                found.append(f"{place}: '{match[0]}' is '{better}': … {around} …")
    assert found == []


def test_the_glossary_has_the_words() -> None:
    glossary = (ROOT / "docs" / "notation.md").read_text(encoding="utf-8").partition("## Symbols")[0].lower()
    for better in REPLACED.values():
        word = better.partition(",")[0]
        assert word in glossary or word in ("ramp time", "violation"), word
