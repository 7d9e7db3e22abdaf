"""Another program of this machine, or a foreign page, tries to lead the robots: packets, requests and frames.

What judges is the operating system's own list of sockets and files, the status lines of the page's server, the calls
that came through, and the states that the robots told. Linux only.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import socket
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from coopqp import ControlStep, load_cell_file
from coopqp.drivers import ControlLoop, LoopOptions
from coopqp.spatial import Array
from promise_cases import Promise

_CELL = Path(__file__).parents[2] / "coopqp" / "scenarios" / "cells" / "two_robots.toml"
#: The loop's period after which strangers begin.
_BEGIN = 100
#: Files in memory that every process of a machine sees.
_MEMORY = ("/dev/shm/", tempfile.gettempdir() + "/")


def _sockets(process: int) -> dict[str, str]:
    """Inodes of the sockets of a process, by the paths under which Linux shows them to its user's other processes."""
    found = {}
    for number in Path(f"/proc/{process}/fd").iterdir():
        with contextlib.suppress(OSError):  # closed meanwhile
            link = os.readlink(number)  # noqa: PTH115  # "socket:[inode]"
            if link.startswith("socket:["):
                found[str(number)] = link[8:-1]
    return found


def doors(process: int) -> set[tuple[str, int]]:
    """Sockets of a process that another process can reach: kind, and port or inode, as Linux lists them."""
    own, found = set(_sockets(process).values()), set()
    for kind, inode in (("udp", 9), ("tcp", 9), ("udp6", 9), ("tcp6", 9), ("unix", 6)):
        with contextlib.suppress(FileNotFoundError):
            for line in Path(f"/proc/{process}/net/{kind}").read_text().splitlines()[1:]:
                row = line.split()
                if row[inode] in own and (kind != "unix" or len(row) > 7):
                    found.add((kind, int(row[1].split(":")[1], 16) if kind != "unix" else int(row[inode])))
    return found


def named_memory(process: int) -> set[str]:
    """Files in memory that a process shares, and that have a name."""
    lines = Path(f"/proc/{process}/maps").read_text().splitlines()
    paths = {line.split(maxsplit=5)[-1] for line in lines if len(line.split(maxsplit=5)) == 6}
    return {path for path in paths if path.startswith(_MEMORY) and not path.endswith("(deleted)")}


def _children() -> set[int]:
    """Processes that this one has started."""
    found = set()
    for file in Path("/proc/self/task").glob("*/children"):
        found |= {int(number) for number in file.read_text().split()}
    return found


def _forged(rng: np.random.Generator) -> bytes:
    """A packet as a stranger may send it: commands, states, orders, errors, and anything."""
    kind = bytes([rng.choice(list(b"CSOE?"))])
    if kind in b"CS":
        head = struct.pack("<cdBBd", kind, float(rng.choice([0.0, 1e10, rng.normal()])), 0, 0, 1.0)
        return head + rng.normal(size=int(rng.choice([0, 7, 14]))).tobytes()
    if kind == b"O":
        orders: list[dict[str, Any]] = [{"order": "limit", "speed": 0.0}, {"order": "end"}, {"order": "halt"}, {}]
        return kind + json.dumps(orders[int(rng.integers(4))]).encode()[: int(rng.integers(1, 60))]
    return kind + rng.bytes(int(rng.integers(0, 40)))


class _Watch:
    """What a run tells.

    Args:
        begin: called once, when it goes on for a while.
    """

    def __init__(self, begin: Callable[[], None]) -> None:
        self._begin, self._number, self.apart = begin, 0, 0.0

    def take(self, moment: float, measured: Array, sent: Array, step: ControlStep, clock: float) -> None:
        """One period."""
        self._number += 1
        if self._number == _BEGIN:
            self._begin()
        if np.isfinite(measured).all():
            self.apart = max(self.apart, float(np.abs(measured - sent).max()))


def _stranger(link: Any, count: int) -> None:
    """Another program, which sends packets by the ways that it is told, and tells how many were taken."""
    link.send("ready")
    ways, rng, taken = link.recv(), np.random.default_rng(0), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setblocking(False)
        for i in range(count):
            packet, way = _forged(rng), ways[i % len(ways)]
            with contextlib.suppress(OSError):
                if isinstance(way, str):
                    opened = os.open(way, os.O_WRONLY | os.O_NONBLOCK)
                    taken += os.write(opened, packet) > 0
                    os.close(opened)
                else:
                    stranger.sendto(packet, ("127.0.0.1", way))
                    taken += len(stranger.recv(65536)) > 0
    link.send(taken)


def _packets(count: int) -> Iterator[Promise]:
    """Simulated robots are driven, each by a process of its own, while packets come by every way that there is.

    Ways are UDP ports, and the paths of sockets in ``/proc``, which no process may open.
    """
    run, here, context = load_cell_file(_CELL).led(), os.getpid(), multiprocessing.get_context("spawn")
    link, theirs = context.Pipe()
    stranger = context.Process(target=_stranger, args=(theirs, count), daemon=True)
    stranger.start()
    theirs.close()
    link.recv()
    doors_before, children, memory = doors(here), _children(), named_memory(here)
    sockets_before = set(_sockets(here).values())
    drivers: Any = run.drivers("sim")
    open_doors: set[tuple[str, int]] = set()

    def begin() -> None:
        own = _children() - children
        open_doors.update(doors(here) - doors_before, *map(doors, own))
        ways: list[int | str] = [port for kind, port in open_doors if kind.startswith("udp")]
        for process in (here, *own):
            ways += [path for path, inode in _sockets(process).items() if inode not in sockets_before]
        link.send(ways)

    watch = _Watch(begin)
    loop = ControlLoop(
        run.controller(), drivers, LoopOptions(ramp_time=0.5, gone_after=10.0, give_up_after=10.0), recorder=watch
    )
    try:
        report = loop.run()
        taken = link.recv()
        own = _children() - children
        names = set[str]().union(*(named_memory(process) for process in (here, *own))) - memory
        ended = len(drivers) - len(own)
    finally:
        for driver in drivers.values():
            driver.close()
        stranger.join(10.0)
    yield Promise("ports and named sockets of drivers and their robots' processes", len(open_doors), 0, "")
    yield Promise("files in memory with a name, of a run", len(names), 0, "")
    yield Promise(f"{count} packets of strangers by every way to a robot: taken", taken + ended, 0, "")
    why = "" if report.finished else f": {report.reason}"
    yield Promise(f"the run under these packets ended early{why}", not report.finished, 0, "")
    yield Promise("a robot was off its commands under these packets", watch.apart, 0.3, "rad")


def _requests(url: str, count: int) -> tuple[int, int]:
    """How many of so many requests of strangers are answered, and how many answers a foreign page may frame."""
    address, rng = urlsplit(url), np.random.default_rng(1)
    host, port, key = str(address.hostname), int(address.port or 0), address.path
    own = f"{host}:{port}"
    hosts, origins = (
        (own, f"evil.example:{port}", "evil.example", ""),
        (None, "null", "http://evil.example", f"http://{own}"),
    )
    paths = ("/", "/coopqp.js", "/coopqp", "/index.html", f"{key[:-1]}/", f"{key}x/", f"/..{key}/", f"/?{key[1:]}")
    answered = framed = 0
    for i in range(count):
        asked, origin = str(rng.choice(hosts)), origins[int(rng.integers(4))]
        # With the whole address it is the page's own, unless host or origin is another's.
        foreign = asked != own or origin not in (None, f"http://{own}")
        path = f"{key}/" if foreign and rng.random() < 0.5 else str(rng.choice(paths))
        lines = [f"GET {path} HTTP/1.1", f"Host: {asked}", *([] if origin is None else [f"Origin: {origin}"])]
        if rng.random() < 0.5:
            lines += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
                      "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="]  # fmt: skip
        with socket.create_connection((host, port), 30.0, (f"127.0.0.{1 + i % 250}", 0)) as stranger:
            stranger.sendall("\r\n".join([*lines, "", ""]).encode())
            answer = stranger.recv(4096)
        answered += not answer.startswith(b"HTTP/1.1 4")
        framed += b"frame-ancestors 'none'" not in answer
    return answered, framed


def _page(count: int) -> Iterator[Promise]:
    """The operator's page: requests without its key or of foreign pages; frames of a page that does not lead."""
    from websockets.sync.client import connect

    from coopqp.cli.runs import obtain_task
    from coopqp.visualization.jog.page import JogPage

    calls: list[str] = []
    page = JogPage(obtain_task("dual_arm7").at_start(), lambda name, *_, **__: calls.append(name), port=0, sticks=True)
    try:
        answered, framed = _requests(page.url, count)
        rng, before = np.random.default_rng(2), len(calls)
        with connect(page.url.replace("http", "ws") + "/coopqp") as stranger:
            for _ in range(count):
                said: dict[str, Any] = {
                    "token": rng.bytes(8).hex(),
                    "call": "pause",
                    "twist": rng.normal(size=6).tolist(),
                }
                text = json.dumps({key: said[key] for key in said if rng.random() < 0.8})
                stranger.send(text if rng.random() < 0.9 else text[: int(rng.integers(0, 80))])
            stranger.ping().wait(60.0)  # all before it were heard
    finally:
        page.close()
    yield Promise(f"{count} requests of strangers to the operator's page: answered", answered, 0, "")
    yield Promise(f"{count} requests of strangers: answers that a foreign page may frame", framed, 0, "")
    yield Promise(f"{count} frames of a page that does not lead: calls", len(calls) - before, 0, "")


def promises(quick: bool) -> Iterator[Promise]:
    """See :mod:`promise_cases`."""
    if sys.platform != "linux":
        return
    count = 500 if quick else 100_000
    yield from _packets(count)
    yield from _page(count)
