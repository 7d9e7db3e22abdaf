"""A robot that speaks RTDE, the dashboard's and the script port's language, as far as ur_rtde asks for it.

Run as ``python ur_stub.py ADDRESS Q`` with Q a JSON list. It prints ``ready`` when its ports are open. Orders come as
lines on its standard input: ``slider 0.5``, ``protective``, ``release``, ``estop``, and ``count`` (of servoJ),
``runs`` (its program).
"""

from __future__ import annotations

import asyncio
import json
import os
import struct
import sys
import time

import numpy as np

from coopqp.drivers.simulated import ServoModel

PERIOD = 0.002
DASHBOARD, SCRIPT, RTDE = 29999, (30001, 30002, 30003), 30004
#: What the dashboard answers.
ANSWERS = {"polyscopeversion": b"URSoftware 5.12.0.1101319 (Mar 11 2022)", "is in remote control": b"true",
           "get serial number": b"20225500001"}  # fmt: skip
#: Commands of the program of ur_rtde, in its first whole-number register.
SERVOJ, SERVO_STOP, STOP_SCRIPT = 11, 16, 255
#: Types of what RTDE carries, and how they are packed.
PACKED = {"DOUBLE": "d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "UINT8": "B", "BOOL": "?",
          "VECTOR6D": "6d", "VECTOR3D": "3d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I"}  # fmt: skip
TYPES = {"timestamp": "DOUBLE", "speed_scaling": "DOUBLE", "target_speed_fraction": "DOUBLE", "safety_mode": "INT32",
         "robot_mode": "INT32", "runtime_state": "UINT32", "robot_status_bits": "UINT32",
         "safety_status_bits": "UINT32"}  # fmt: skip


def type_of(name: str) -> str:
    """The type of a variable."""
    if "double_register" in name:
        return "DOUBLE"
    if "int_register" in name:
        return "INT32"
    return TYPES.get(name, "VECTOR6D" if name.startswith(("actual_", "target_")) else "UINT32")


def names_in(body: bytes) -> list[str]:
    """The variables that are asked for."""
    return [name for name in body.decode().split(",") if name]


class Robot:
    """Servo, registers and switches."""

    def __init__(self, q: list[float]) -> None:
        self.servo = ServoModel(np.array(q), lag=0.02, delay=0.0)
        self.began = time.monotonic()
        self.runs = self.protective = self.estop = False
        self.slider = 1.0
        self.servoed = 0
        self.done = 1  # ready for a command
        self.registers: dict[str, float] = {}

    def now(self) -> float:
        return time.monotonic() - self.began

    def take(self, values: dict[str, float]) -> None:
        """Registers that were written."""
        self.registers.update(values)
        command = int(self.registers.get("input_int_register_0", 0))
        if command == 0:
            self.done = 1
        elif command == SERVOJ:
            if self.runs and not (self.protective or self.estop):
                self.servoed += 1
                q = np.array([self.registers[f"input_double_register_{i}"] for i in range(6)])
                self.servo.push(self.now() + PERIOD, q)
        elif command == STOP_SCRIPT:
            self.runs = False
            self.servo.halt()
        else:
            if command == SERVO_STOP:
                self.servo.halt()
            self.done = 2

    def order(self, line: str) -> None:
        """What may happen to a robot."""
        word, *rest = line.split()
        if word == "slider":
            self.slider = float(rest[0])
            self.servo.limit(None if self.slider == 1.0 else 0.3 * self.slider)
        elif word == "protective":
            self.protective = True
            self.servo.halt()
        elif word == "release":
            self.protective = False
            self.servo.release()
        elif word == "estop":
            self.estop = True
            self.servo.halt()
        elif word == "count":
            print(self.servoed, flush=True)
        elif word == "runs":
            print(self.runs, flush=True)

    def value(self, name: str) -> tuple:
        """A variable's value."""
        servo = self.servo
        safety = 7 if self.estop else 3 if self.protective else 1
        known = {
            "timestamp": servo.now + 1000.0, "actual_q": servo.q, "actual_qd": servo.velocity, "target_q": servo.target,
            "speed_scaling": 1.0, "target_speed_fraction": self.slider, "safety_mode": safety,
            "runtime_state": 2 if self.runs else 1, "robot_mode": 7, "robot_status_bits": 1 | (2 if self.runs else 0),
            "safety_status_bits": 1 | (4 if self.protective else 0) | (64 if self.estop else 0),
            "output_int_register_0": self.done,
            "actual_TCP_pose": (0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2), "actual_TCP_force": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        }  # fmt: skip
        value = known.get(name, 0)
        count = int(PACKED[type_of(name)][:-1] or 1)
        return tuple(np.ravel(value)) if count > 1 and np.size(value) == count else (value,) * count


class Link:
    """One RTDE connection: its recipes, and whether states are sent."""

    def __init__(self, robot: Robot, writer: asyncio.StreamWriter) -> None:
        self.robot, self.writer = robot, writer
        self.outputs: list[str] = []
        self.inputs: list[list[str]] = []
        self.started = False
        self.every, self.ticks = 1, 0

    def answer(self, kind: int, body: bytes) -> None:
        self.writer.write(struct.pack(">HB", len(body) + 3, kind) + body)

    def take(self, kind: int, body: bytes) -> None:
        """One packet."""
        robot = self.robot
        if kind == ord("V"):
            self.answer(kind, b"\x01")
        elif kind == ord("v"):
            self.answer(kind, struct.pack(">4I", 5, 12, 0, 0))
        elif kind == ord("O"):
            self.outputs = names_in(body[8:])
            self.every = max(1, round(1.0 / (struct.unpack(">d", body[:8])[0] * PERIOD)))
            self.answer(kind, b"\x01" + ",".join(map(type_of, self.outputs)).encode())
        elif kind == ord("I"):
            self.inputs.append(names_in(body))
            self.answer(kind, bytes([len(self.inputs)]) + ",".join(map(type_of, self.inputs[-1])).encode())
        elif kind in (ord("S"), ord("P")):
            self.started = kind == ord("S")
            self.answer(kind, b"\x01")
        elif kind == ord("U"):
            names = self.inputs[body[0] - 1]
            layout = ">" + "".join(PACKED[type_of(name)] for name in names)
            robot.take(dict(zip(names, struct.unpack(layout, body[1:]), strict=True)))

    def tell(self) -> None:
        """A state, as often as it was asked for."""
        self.ticks += 1
        if self.ticks % self.every:
            return
        layout = ">" + "".join(PACKED[type_of(name)] for name in self.outputs)
        values = [x for name in self.outputs for x in self.robot.value(name)]
        self.answer(ord("U"), b"\x01" + struct.pack(layout, *values))


async def main(address: str, q: list[float]) -> None:
    robot, links = Robot(q), set[Link]()

    async def rtde(reader, writer):
        link = Link(robot, writer)
        links.add(link)
        try:
            while True:
                size, kind = struct.unpack(">HB", await reader.readexactly(3))
                link.take(kind, await reader.readexactly(size - 3))
        except (asyncio.IncompleteReadError, ConnectionError):
            links.discard(link)

    async def dashboard(reader, writer):
        writer.write(b"Connected: Universal Robots Dashboard Server\n")
        while line := (await reader.readline()).decode().strip().lower():
            robot.runs = robot.runs and line != "stop"
            writer.write(ANSWERS.get(line, b"Stopped") + b"\n")

    async def script(reader, writer):
        while await reader.read(65536):
            robot.runs = True

    async def orders():
        loop = asyncio.get_running_loop()
        lines = asyncio.StreamReader()
        await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
        while line := (await lines.readline()).decode().strip():
            robot.order(line)

    async def tick():
        due = time.monotonic()
        while True:
            robot.servo.advance(robot.now())
            for link in list(links):
                if link.started and not link.writer.is_closing():
                    link.tell()
            due = max(due + PERIOD, time.monotonic())  # nothing is made up for
            await asyncio.sleep(max(0.0, due - time.monotonic()))

    ticking = asyncio.create_task(tick())
    for handler, ports in ((dashboard, (DASHBOARD,)), (script, SCRIPT), (rtde, (RTDE,))):
        for port in ports:
            await asyncio.start_server(handler, address, port)
    print("ready", flush=True)
    await orders()
    ticking.cancel()
    os._exit(0)  # its driver is gone


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], json.loads(sys.argv[2])))
