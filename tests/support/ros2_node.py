"""A node beside a control loop: by rclpy where this Python has it, else by Cyclone DDS. Shares no code with the board.

Run as ``python ros2_node.py SETTINGS`` with JSON: ``domain``, ``status``, ``object``, ``target`` (topics). It prints
``ready``, then what comes: ``["status", level, name, message, values]`` and ``["object", frame, x, y, z, …]``. Each
line that it reads is published as a target: ``[frame, x, y, z, qx, qy, qz, qw]``.
"""

import json
import sys
import threading
import time


def by_rclpy(settings):
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseStamped
    from rclpy.node import Node

    rclpy.init(domain_id=settings["domain"])
    node = Node("coopqp_listener")
    node.create_subscription(DiagnosticArray, settings["status"], status, 10)
    node.create_subscription(PoseStamped, settings["object"], placed, 10)
    targets = node.create_publisher(PoseStamped, settings["target"], 10)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    return PoseStamped, targets.publish, lambda: None


def by_cyclone(settings):
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    from coopqp.drivers import ros2_messages as m
    from coopqp.drivers.ros2_domain import LOCALHOST

    domain = Domain(settings["domain"], f'<CycloneDDS><Domain id="any">{LOCALHOST}</Domain></CycloneDDS>')
    p = DomainParticipant(settings["domain"])
    readers = [(DataReader(p, Topic(p, "rt" + settings["status"], m.DiagnosticArray)), m.DiagnosticArray, status),
               (DataReader(p, Topic(p, "rt" + settings["object"], m.PoseStamped)), m.PoseStamped, placed)]  # fmt: skip
    writer = DataWriter(p, Topic(p, "rt" + settings["target"], m.PoseStamped))

    def take(domain=domain):
        for reader, kind, call in readers:
            for sample in reader.take(10):
                if isinstance(sample, kind):
                    call(sample)

    return m.PoseStamped, writer.write, take


def status(message):
    part = message.status[0]
    level = part.level[0] if isinstance(part.level, bytes) else part.level
    say(["status", level, part.name, part.message, {value.key: value.value for value in part.values}])


def placed(message):
    p, r = message.pose.position, message.pose.orientation
    say(["object", message.header.frame_id, p.x, p.y, p.z, r.x, r.y, r.z, r.w])


def say(what):
    print(json.dumps(what), flush=True)


def main(settings):
    try:
        kind, publish, take = by_rclpy(settings)
    except ImportError:
        kind, publish, take = by_cyclone(settings)

    def orders():
        for line in sys.stdin:
            message, (frame, *numbers) = kind(), json.loads(line)
            message.header.frame_id = frame
            p, r = message.pose.position, message.pose.orientation
            p.x, p.y, p.z, r.x, r.y, r.z, r.w = numbers
            publish(message)

    reader = threading.Thread(target=orders, daemon=True)
    reader.start()
    print("ready", flush=True)
    while reader.is_alive():
        take()
        time.sleep(0.005)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
