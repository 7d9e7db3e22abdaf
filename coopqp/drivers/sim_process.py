"""The robot of the driver ``sim``: a servo in a process of its own, with a link that is late and loses packets.

Run as ``python -m coopqp.drivers.sim_process SETTINGS``; the settings are JSON, written by the driver.
"""

from __future__ import annotations

import heapq
import json
import os
import sys
import time
from typing import Any

import numpy as np

from coopqp.drivers.driver import Condition, RobotState
from coopqp.drivers.packet_pair import PacketEnd
from coopqp.drivers.packets import COMMAND, ORDER, pack_state, unpack_command, unpack_order
from coopqp.drivers.simulated import ServoModel

#: How often it looks whether its driver is still there [s].
_LOOK = 0.25


def _obey(servo: ServoModel, order: dict[str, Any]) -> None:
    name = order["order"]
    if name == "halt":
        servo.halt(says=Condition(order.get("says", Condition.RUNNING.value)))
    elif name == "release":
        servo.release()
    elif name == "limit":
        servo.limit(order["speed"])


def serve(settings: dict[str, Any]) -> None:
    """Be the robot until its driver is gone."""
    rng = np.random.default_rng(settings["seed"])
    link = PacketEnd.inherited(settings["link"])
    began, period, parent = time.monotonic(), settings["period"], os.getppid()
    servo = ServoModel(np.array(settings["q"], dtype=float), lag=settings["lag"], delay=settings["delay"])
    # What is on its way: (due, number, packet, to the driver).
    under_way: list[tuple[float, int, bytes, bool]] = []
    number, next_state, next_look = 0, 0.0, _LOOK

    def carry(packet: bytes, now: float, *, out: bool) -> None:
        nonlocal number
        if packet[:1] != ORDER and rng.random() < settings["loss"]:
            return
        number += 1
        late = settings["latency"] + settings["jitter"] * rng.random()
        heapq.heappush(under_way, (now + (0.0 if packet[:1] == ORDER else late), number, packet, out))

    while True:
        now = time.monotonic() - began
        due = min(next_state, under_way[0][0] if under_way else next_state)
        if due > now and link.waits(due - now):
            try:
                for packet in link.packets():
                    carry(packet, time.monotonic() - began, out=False)
            except EOFError:
                return
        now = time.monotonic() - began
        while under_way and under_way[0][0] <= now:
            _, _, packet, out = heapq.heappop(under_way)
            if out:
                link.send(packet)
            elif packet[:1] == COMMAND:
                at, q = unpack_command(packet)
                servo.push(at - settings["clock_offset"], q)
            else:
                _obey(servo, unpack_order(packet))
        servo.advance(now)
        if now >= next_state:
            target = servo.target if settings["tells_target"] else None
            stamp = servo.now + settings["clock_offset"]
            state = RobotState(servo.q, servo.velocity, stamp, target=target, condition=servo.condition)
            carry(pack_state(state), now, out=True)
            next_state += period * (1 + int((now - next_state) / period))
        if now >= next_look:
            next_look = now + _LOOK
            if os.getppid() != parent:
                return


if __name__ == "__main__":
    serve(json.loads(sys.argv[1]))
