"""A node of rclpy whose arms are at once where they are sent: what comes back is the age of a command.

Run by a Python with rclpy as ``python ros2_echo.py SETTINGS`` with JSON: ``arms`` (name to joint names), ``domain``.
Each arm takes ``/NAME/joint_trajectory`` and tells ``/NAME/states``. It prints ``ready``, and for a line ``count`` how
many commands each arm got.
"""

from __future__ import annotations

import gc
import json
import sys
import threading
import time
from typing import Any

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

#: Messages that are kept while the node is not run.
_QUEUE = 100
#: Time between looks for commands [s].
_LOOKS = 2e-4


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

    def nothing(_: Any) -> None: ...

    subscriptions: dict[str, Any] = {}
    for name in settings["arms"]:
        publishers[name] = node.create_publisher(JointState, f"/{name}/states", _QUEUE)
        topic = f"/{name}/joint_trajectory"
        subscriptions[name] = node.create_subscription(JointTrajectory, topic, nothing, _QUEUE)

    def echo() -> None:
        """Send back what has come. An executor would build a set to wait for at each message."""
        while True:
            for name, subscription in subscriptions.items():
                while taken := subscription.handle.take_message(JointTrajectory, False):
                    if taken[0].points:
                        counts[name] += 1
                        tell(name, list(taken[0].points[-1].positions))
            time.sleep(_LOOKS)

    gc.collect()  # a pause to collect what rclpy has made would be counted as its transport's
    gc.freeze()
    threading.Thread(target=echo, daemon=True).start()

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
