"""The promises that coopqp makes with its default options, each as one number beside its bound.

Records have the keys ``group``, ``case``, ``value``, ``bound``, ``unit`` and ``holds``. A value holds if it is at most
its bound; NaN never holds. Cells, motions and seeds are random but fixed, and what judges a run shares no code with
the controller. ``promise_cases`` has one module for each set of cases. The exit code is 1 if a promise is broken.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import common  # first: it limits BLAS to one thread
import promise_cases
from common import Record
from promise_cases import (
    at_limits,
    bodies,
    braking,
    calls,
    certified,
    chain,
    clock,
    contacts,
    description_files,
    forces,
    operator,
    planning,
    programs,
    proofs,
    real_robots,
    robots,
    screen,
    sensors,
    shared,
    strangers,
    too_quick,
)

KEYS = ("group", "case", "value", "bound", "unit", "holds")
#: The groups, and where their cases come from.
GROUPS: dict[str, tuple[Callable[[bool], Iterator[promise_cases.Promise]], ...]] = {
    "chain": (chain.promises, braking.promises),
    "forces": (forces.promises, contacts.promises, sensors.promises),
    "planning": (proofs.promises, planning.promises, bodies.promises),
    "clock": (clock.promises,),
    "operator": (operator.promises,),
    "programs": (programs.promises,),
    "screen": (screen.promises,),
    "shared": (shared.promises, robots.promises),
    "robot": (
        real_robots.promises,
        strangers.promises,
        certified.promises,
        description_files.promises,
        too_quick.promises,
        calls.promises,
        at_limits.promises,
    ),
}


def records(groups: Sequence[str], *, quick: bool) -> Iterator[Record]:
    """The records of some groups, in their order."""
    for group in groups:
        for promises in GROUPS[group]:
            for p in promises(quick):
                yield {
                    "group": group, "case": p.case, "value": float(p.value), "bound": float(p.bound), "unit": p.unit,
                    "holds": bool(p.value <= p.bound),
                }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    parser = common.arguments(__doc__.splitlines()[0])
    parser.add_argument("--group", nargs="+", choices=list(GROUPS), default=list(GROUPS), help="only these groups")
    given: Any = parser.parse_args(arguments)
    began = time.perf_counter()
    description = common.describe("promises with default options", {"quick": given.quick, "groups": given.group})
    print(common.header(description))
    found = []
    for record in records(given.group, quick=given.quick):
        found.append(record)
        mark = "holds" if record["holds"] else "BROKEN"
        measured = f"{record['value']:10.4g} ≤ {record['bound']:g} {record['unit']}"
        print(f"{record['group']:9} {record['case']:70} {measured}  {mark}", flush=True)
    broken = sum(not record["holds"] for record in found)
    print(f"{len(found)} promises, {broken} broken, {time.perf_counter() - began:.0f} s")
    table = common.markdown_table(found, KEYS).encode()
    common.save(found, description, json_file=given.json, out=given.out, files={"promises.md": table})
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
