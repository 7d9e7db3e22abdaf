"""Stand-ins of UR robots, in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

STUB = Path(__file__).with_name("ur_stub.py")


class UrStub:
    """A robot at an address of the loopback network, with orders to it."""

    def __init__(self, address: str, q) -> None:
        self.address = address
        command = [sys.executable, str(STUB), address, json.dumps(list(q))]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline() == "ready\n"

    def order(self, line: str) -> None:
        """One of the orders of ur_stub."""
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def servoed(self) -> int:
        """How many servoJ came so far."""
        self.order("count")
        return int(self.process.stdout.readline())

    def runs(self) -> bool:
        """Whether its program runs."""
        self.order("runs")
        return self.process.stdout.readline() == "True\n"

    def close(self) -> None:
        """End it."""
        self.process.kill()
        self.process.communicate()
