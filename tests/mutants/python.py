"""Mutants of Python: cosmic-ray's operators and runner, on a sample of the places of a package."""

from __future__ import annotations

import random
import shlex
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.commands import execute, init
from cosmic_ray.config import ConfigDict
from cosmic_ray.modules import find_modules
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import TestOutcome, WorkItem

#: Where a star multiplies nothing.
_STARRED = ("parameters", "typedargslist", "param", "argument", "arglist", "star_expr")


def _no_places(module: Path) -> Iterator[tuple[Any, Any]]:
    """Where types are written, which nothing evaluates, and stars that multiply nothing."""
    for node in ast_nodes(get_ast_from_path(module)):
        if node.type == "annassign":
            yield node.children[1].start_pos, node.children[1].end_pos
        elif node.type in ("param", "funcdef") and node.annotation is not None:
            yield node.annotation.start_pos, node.annotation.end_pos
        elif node.type == "operator" and node.parent.type in _STARRED:
            yield node.start_pos, node.end_pos


def sample(modules: list[Path], number: int, seed: int) -> list[WorkItem]:
    """Mutants at ``number`` places of modules, one a place; any place is as likely as any other."""
    places: dict[tuple[Path, Any], list[WorkItem]] = {}
    left_out = {module: list(_no_places(module)) for module in modules}
    with tempfile.TemporaryDirectory() as folder, use_db(f"{folder}/all.sqlite") as db:
        init(modules, db, {})
        for item in sorted(db.work_items, key=lambda i: (i.mutations[0].operator_name, i.mutations[0].occurrence)):
            (change,) = item.mutations
            start, end = tuple(change.start_pos), tuple(change.end_pos)
            if not any(a <= start and end <= b for a, b in left_out[change.module_path]):
                places.setdefault((change.module_path, start), []).append(item)
    rng = random.Random(seed)
    chosen = rng.sample(sorted(places), min(number, len(places)))
    return [rng.choice(places[place]) for place in chosen]


def run(package: str, sessions: Path, *, number: int, seed: int, seconds: float) -> Iterator[dict[str, Any]]:
    """Mutants of a package of the tree in the working directory meet the tests of its folder; survivors all others.

    Sessions of cosmic-ray are kept in ``sessions``, and gone on with. A mutant that takes longer than ``seconds`` runs
    for ever. Yields one entry a mutant.
    """
    own = f"tests/{package}"
    others = ["tests", f"--ignore={own}", "--ignore=tests/browser"]
    items = sample(sorted(find_modules([Path("coopqp", package)])), number, seed)
    for stage, tests in (("own", [own]), ("others", others)):
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *tests]
        config = {"test-command": shlex.join(command), "timeout": seconds, "distributor": {"name": "local"}}
        with use_db(str(sessions / f"{package}-{number}-{seed}-{stage}.sqlite")) as db:
            if not db.num_work_items:
                db.add_work_items(items)
            execute(db, ConfigDict(config))
            done = db.completed_work_items
        items = [item for item, result in done if result.test_outcome is TestOutcome.SURVIVED]
        for item, result in done:
            if item not in items or stage == "others":
                (change,) = item.mutations
                yield {
                    "module": str(change.module_path), "operator": change.operator_name, "line": change.start_pos[0],
                    "occurrence": change.occurrence, "diff": result.diff,
                    "killer": "" if item in items else f"tests: {stage}",
                }  # fmt: skip
