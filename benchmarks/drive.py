"""The control loop on robots: each figure beside its bound.

Records have the keys ``case``, ``value``, ``bound``, ``unit`` and ``holds``. A value holds if it is at most its bound;
NaN never holds. With ``--quick`` all robots are simulated, on time that nothing waits for: the figures are the same on
each machine. Without it more rows run in real time, ten minutes and longer, against what robots speak. They need a
quiet machine, ``COOPQP_ROS_PYTHON`` (a Python with rclpy) and ``franky-sim`` on the path; those without their peer are
named. The exit code is 1 if a figure does not hold.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import common  # first: it limits BLAS to one thread
import drive_cases
import drive_peers
from common import Record
from drive_runs import Row

from coopqp.errors import MissingExtraError

KEYS = ("case", "value", "bound", "unit", "holds")
#: Rows that are nowhere here, and where they are shown.
ELSEWHERE = (
    "a controller killed in position mode: tests/drivers/test_ur.py, test_a_loop_that_is_killed_leaves_no_robot_moving",
    "an extra alone, and the core without it: `.ci/environments.py extras`",
)


def rows(case: Callable[[], Iterator[Row]], left_out: list[str]) -> Iterator[Row]:
    """The rows of a case; one without its peer is noted among those left out."""
    try:
        yield from case()
    except (drive_peers.MissingPeerError, MissingExtraError) as missing:
        left_out.append(f"{(case.__doc__ or '').strip()} {missing}")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = common.arguments(__doc__.splitlines()[0])
    given: Any = parser.parse_args(arguments)
    began = time.perf_counter()
    description = common.describe("the control loop on simulated robots", {"quick": given.quick})
    print(common.header(description))
    found: list[Record] = []
    left_out = list(ELSEWHERE)
    longer = drive_cases.LONGER + drive_peers.PEERS
    for case in drive_cases.QUICK + (() if given.quick else longer):
        for row in rows(case, left_out):
            record = {
                "case": row.case, "value": float(row.value), "bound": float(row.bound), "unit": row.unit,
                "holds": bool(row.value <= row.bound),
            }  # fmt: skip
            found.append(record)
            mark = "holds" if record["holds"] else "BROKEN"
            print(f"{row.case:80} {row.value:10.4g} ≤ {row.bound:.4g} {row.unit}  {mark}", flush=True)
    if given.quick:
        reasons = ["it takes a minute"] * len(drive_cases.LONGER) + ["in real time, against peers"] * len(
            drive_peers.PEERS
        )
        left_out += [f"{(case.__doc__ or '').strip()} ({why})" for case, why in zip(longer, reasons, strict=True)]
    for line in left_out:
        print("left out:", line)
    broken = sum(not record["holds"] for record in found)
    print(f"{len(found)} figures, {broken} do not hold, {time.perf_counter() - began:.0f} s")
    table = common.markdown_table(found, KEYS).encode()
    common.save(found, description, json_file=given.json, out=given.out, files={"drive.md": table})
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
