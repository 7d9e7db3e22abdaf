"""Arms behind ROS 2 topics: by rclpy where this Python has it, else by Cyclone DDS. Shares no code with the driver.

Run as ``python ros2_peer.py SETTINGS`` with JSON: ``arms`` (name → joint names and positions), ``domain``, ``lag``;
optional: ``period`` between two states [s] (0.004), ``wrenches`` (true). All joints stand in one JointState, last ones
first; each arm takes ``/NAME/joint_trajectory`` and ``/NAME/commands``, and tells ``/NAME/wrench``. It prints
``ready``, and for a line ``count`` how many commands each arm got.
"""

import gc
import json
import math
import sys
import threading
import time

PERIOD = 0.004


class Arm:
    """Joints that go in a straight line to where they should be, and lag."""

    def __init__(self, joints, q, lag):
        self.joints, self.q, self.lag = joints, list(q), lag
        self.target, self.velocity = list(q), [0.0] * len(q)
        self.goal, self.at, self.count = list(q), 0.0, 0

    def take(self, names, positions, at):
        self.count += bool(positions)  # a trajectory without points is an order to stop
        if positions:
            self.goal = [positions[names.index(name)] for name in self.joints]
            self.at = at
        else:
            self.goal, self.at = list(self.target), 0.0

    def go_on(self, now, h):
        left = max(self.at - (now - h), h)
        share, kept = min(h / left, 1.0), math.exp(-h / self.lag)
        for i, goal in enumerate(self.goal):
            self.target[i] += share * (goal - self.target[i])
            moved = (1.0 - kept) * (self.target[i] - self.q[i])
            self.q[i] += moved
            self.velocity[i] = moved / h


def seconds(stamp):
    return stamp.sec + 1e-9 * stamp.nanosec


class ByRclpy:
    def __init__(self, arms, domain):
        import rclpy
        from geometry_msgs.msg import WrenchStamped
        from rclpy.node import Node
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory

        rclpy.init(domain_id=domain)
        self.node = Node("coopqp_peer")
        self.types = JointState, WrenchStamped
        self.states = self.node.create_publisher(JointState, "/joint_states", 10)
        self.wrenches = {}
        for name, arm in arms.items():
            self.wrenches[name] = self.node.create_publisher(WrenchStamped, f"/{name}/wrench", 10)
            # Deep enough for what comes while this process is not run.
            self.node.create_subscription(JointTrajectory, f"/{name}/joint_trajectory", by_trajectory(arm), 100)
            self.node.create_subscription(Float64MultiArray, f"/{name}/commands", by_positions(arm), 100)
        threading.Thread(target=rclpy.spin, args=(self.node,), daemon=True).start()

    def tell(self, publisher, message):
        publisher.publish(message)

    def take(self):
        pass


class ByCyclone:
    def __init__(self, arms, domain):
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        from coopqp.drivers import ros2_messages as m
        from coopqp.drivers.ros2_domain import LOCALHOST

        self.domain = Domain(domain, f'<CycloneDDS><Domain id="any">{LOCALHOST}</Domain></CycloneDDS>')
        p = DomainParticipant(domain)
        self.types = m.JointState, m.WrenchStamped
        self.states = DataWriter(p, Topic(p, "rt/joint_states", m.JointState))
        self.wrenches, self.readers = {}, []
        for name, arm in arms.items():
            self.wrenches[name] = DataWriter(p, Topic(p, f"rt/{name}/wrench", m.WrenchStamped))
            for kind, topic, call in ((m.JointTrajectory, "joint_trajectory", by_trajectory(arm)),
                                      (m.Float64MultiArray, "commands", by_positions(arm))):  # fmt: skip
                self.readers.append((DataReader(p, Topic(p, f"rt/{name}/{topic}", kind)), kind, call))

    def tell(self, writer, message):
        writer.write(message)

    def take(self):
        for reader, kind, call in self.readers:
            for sample in reader.take(10):
                if isinstance(sample, kind):
                    call(sample)


def by_trajectory(arm):
    def call(message):
        points = list(message.points)
        at = seconds(message.header.stamp) + (seconds(points[-1].time_from_start) if points else 0.0)
        arm.take(list(message.joint_names), list(points[-1].positions) if points else [], at)

    return call


def by_positions(arm):
    return lambda message: arm.take(arm.joints, list(message.data), 0.0)


def main(settings):
    arms = {name: Arm(*given, settings["lag"]) for name, given in settings["arms"].items()}
    try:
        import rclpy  # noqa: F401

        peer = ByRclpy(arms, settings["domain"])
    except ImportError:
        peer = ByCyclone(arms, settings["domain"])

    def orders():
        for line in sys.stdin:
            if line.strip() == "count":
                print(json.dumps({name: arm.count for name, arm in arms.items()}), flush=True)

    reader = threading.Thread(target=orders, daemon=True)
    reader.start()
    print("ready", type(peer).__name__, flush=True)
    state, wrench = peer.types
    period, wrenches = settings.get("period", PERIOD), peer.wrenches.values() if settings.get("wrenches", True) else ()
    sys.setswitchinterval(1e-4)  # commands are taken by another thread
    gc.collect()
    gc.freeze()
    last, deadline = time.time(), time.monotonic()
    while reader.is_alive():
        peer.take()
        now = time.time()
        for arm in arms.values():
            arm.go_on(now, max(now - last, 1e-6))
        last = now
        message = state()
        message.header.stamp.sec, message.header.stamp.nanosec = int(now), int(1e9 * (now % 1.0))
        for part in ("name", "position", "velocity"):
            values = []
            for arm in arms.values():
                values += {"name": arm.joints, "position": arm.q, "velocity": arm.velocity}[part]
            setattr(message, part, values[::-1])
        peer.tell(peer.states, message)
        for publisher in wrenches:
            message = wrench()
            message.wrench.force.x, message.wrench.torque.z = 1.5, -0.5
            peer.tell(publisher, message)
        deadline = max(deadline + period, time.monotonic())
        time.sleep(max(deadline - time.monotonic(), 0.0))


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
