"""The subcommand ``coopqp examples``: the cell files that come with coopqp."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coopqp.cli.terminal import add_command, print_table


def _add_examples(commands: Any) -> None:
    add_command(
        commands,
        "examples",
        _run_examples,
        help="list the cell files that come with coopqp",
        description="List the cell files that come with coopqp: name, robots, extras that they need, and what happens.",
        epilog="`coopqp schema --example NAME` prints one of them.",
    )


def _run_examples(_: argparse.Namespace) -> int:
    from coopqp.files.cellfile import CELLS, example_path
    from coopqp.files.cellfile.text import read_tables

    rows = [("cell", "robots", "extras", "what happens")]
    for name in CELLS:
        file = example_path(name)
        tables = read_tables(file)
        rows.append((name, _robots(tables), ",".join(needed_extras(tables)), _first_line(file)))
    print_table(rows, numeric=(False, False, False, False))
    print("\ncoopqp schema --example NAME > NAME.toml; pip install 'coopqp[EXTRA]' for one that needs extras")
    return 0


def _robots(tables: Mapping[str, Any]) -> str:
    """The robots of a cell file with their numbers, as ``2 panda, 2 ur5``."""
    names = _names(tables)
    return ", ".join(f"{names.count(name)} {name}" for name in dict.fromkeys(names))


def _names(tables: Mapping[str, Any]) -> list[str]:
    """The names of the arms' robots, and of those that have several arms."""
    return [each["robot"] for each in (*tables.get("robots", ()), *tables["arms"]) if "robot" in each]


def needed_extras(tables: Mapping[str, Any]) -> tuple[str, ...]:
    """The extras of coopqp without which the tables of a cell file cannot be run."""
    from coopqp.scenarios.arms import ROBOTS

    extras = {ROBOTS[name].extra for name in _names(tables) if name in ROBOTS} - {""}
    if tables.get("plant", {}).get("kind") == "physics":
        extras.add("mujoco")
    return tuple(sorted(extras))


def _first_line(file: Path) -> str:
    """The comment at the top of a cell file: one sentence."""
    return file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("#").strip()


COMMANDS = (_add_examples,)
