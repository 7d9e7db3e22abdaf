"""A node of rclpy whose arms are at once where they are sent: what comes back is the age of a command.

Run by a Python with rclpy as ``python ros2_echo.py SETTINGS`` with JSON: ``arms`` (name to joint names), ``domain``.
Each arm takes ``/NAME/joint_trajectory`` and tells ``/NAME/states``. It prints ``ready``, and for a line ``count`` how
many commands each arm got.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory


def main(settings: dict[str, Any]) -> None:
    rclpy.init(domain_id=settings["domain"])
    node = Node("coopqp_echo")
    counts: dict[str, int] = dict.fromkeys(settings["arms"], 0)
    publishers: dict[str, Any] = {}

    def tell(name: str, q: list[float]) -> None:
        message, now = JointState(), time.time()
        message.header.stamp.sec, message.header.stamp.nanosec = int(now), int(1e9 * (now % 1.0))
        message.name, message.position = settings["arms"][name], q
        message.velocity = [0.0] * len(q)
        publishers[name].publish(message)

    def echo(name: str) -> Callable[[Any], None]:
        def call(message: Any) -> None:
            if message.points:
                counts[name] += 1
                tell(name, list(message.points[-1].positions))

        return call

    for name in settings["arms"]:
        publishers[name] = node.create_publisher(JointState, f"/{name}/states", 10)
        node.create_subscription(JointTrajectory, f"/{name}/joint_trajectory", echo(name), 10)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()

    def orders() -> None:
        for line in sys.stdin:
            if line.strip() == "count":
                print(json.dumps(counts), flush=True)

    reader = threading.Thread(target=orders, daemon=True)
    reader.start()
    print("ready", flush=True)
    while reader.is_alive():
        for name, joints in settings["arms"].items():
            if not counts[name]:
                tell(name, [0.0] * len(joints))
        time.sleep(0.1)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
