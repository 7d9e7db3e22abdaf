"""URDFs of known arms, written from their makers' published kinematics: rods for links, no meshes, no masses.

For arms that no package at hand describes. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, inf, pi, radians

#: Radius of a rod [m].
_RADIUS = 0.03


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A joint: its place in the frame of the joint before it, its axis, its limits.

    Attributes:
        xyz, rpy: origin [m] and roll, pitch, yaw [rad].
        axis: axis in its own frame.
        low, high, speed: limits [rad, rad/s or m, m/s]; a joint that turns without limits is continuous.
        slides: whether it slides.
    """

    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    low: float = -inf
    high: float = inf
    speed: float = 1.0
    slides: bool = False


@dataclass(frozen=True, kw_only=True)
class Written:
    """An arm to be written: its joints, and its tool in the frame of the last one."""

    joints: tuple[Joint, ...]
    tool: str
    tool_xyz: tuple[float, float, float]
    tool_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _turning(xyz: tuple[float, float, float], rpy: tuple[float, float, float], most: float, speed: float) -> Joint:
    """A joint that turns about z, with limits [deg, deg/s]; without limits from 360° on."""
    limit = radians(most) if most < 360.0 else inf
    return Joint(xyz=xyz, rpy=rpy, low=-limit, high=limit, speed=radians(speed))


_UP = pi / 2.0
ARMS = {
    "iiwa14": Written(  # KUKA LBR iiwa 14 R820
        joints=(
            _turning((0, 0, 0.1575), (0, 0, 0), 170, 85),
            _turning((0, 0, 0.2025), (_UP, 0, pi), 120, 85),
            _turning((0, 0.2045, 0), (_UP, 0, pi), 170, 100),
            _turning((0, 0, 0.2155), (_UP, 0, 0), 120, 75),
            _turning((0, 0.1845, 0), (-_UP, pi, 0), 170, 130),
            _turning((0, 0, 0.2155), (_UP, 0, 0), 120, 135),
            _turning((0, 0.081, 0), (-_UP, pi, 0), 175, 135),
        ),
        tool="iiwa_link_ee",
        tool_xyz=(0, 0, 0.045),
    ),
    "gen3": Written(  # Kinova Gen3, seven joints
        joints=(
            _turning((0, 0, 0.15643), (pi, 0, 0), 360, 79.6),
            _turning((0, 0.005375, -0.12838), (_UP, 0, 0), 128.9, 79.6),
            _turning((0, -0.21038, -0.006375), (-_UP, 0, 0), 360, 79.6),
            _turning((0, 0.006375, -0.21038), (_UP, 0, 0), 147.8, 79.6),
            _turning((0, -0.20843, -0.006375), (-_UP, 0, 0), 360, 69.9),
            _turning((0, 0.00017505, -0.10593), (_UP, 0, 0), 120.3, 69.9),
            _turning((0, -0.10593, -0.00017505), (-_UP, 0, 0), 360, 69.9),
        ),
        tool="end_effector_link",
        tool_xyz=(0, 0, -0.0615),
        tool_rpy=(pi, 0, 0),
    ),
    "ur5e": Written(  # Universal Robots UR5e; a_2, a_3 along x, d_4, d_5, d_6 along the joints
        joints=(
            Joint(xyz=(0, 0, 0.1625), low=-2 * pi, high=2 * pi, speed=pi),
            Joint(xyz=(0, 0, 0), rpy=(_UP, 0, 0), low=-2 * pi, high=2 * pi, speed=pi),
            Joint(xyz=(-0.425, 0, 0), low=-pi, high=pi, speed=pi),
            Joint(xyz=(-0.3922, 0, 0.1333), low=-2 * pi, high=2 * pi, speed=pi),
            Joint(xyz=(0, -0.0997, 0), rpy=(_UP, 0, 0), low=-2 * pi, high=2 * pi, speed=pi),
            Joint(xyz=(0, 0.0996, 0), rpy=(-_UP, 0, 0), low=-2 * pi, high=2 * pi, speed=pi),
        ),
        tool="tool0",
        tool_xyz=(0, 0, 0),
    ),
    "gantry": Written(  # three sliders below a frame of 1.6 m, and a wrist: made up
        joints=(
            Joint(xyz=(0, 0, 1.6), axis=(1, 0, 0), low=0.0, high=1.6, speed=1.0, slides=True),
            Joint(xyz=(0, 0, 0), axis=(0, 1, 0), low=0.0, high=1.2, speed=1.0, slides=True),
            Joint(xyz=(0, 0, -0.2), axis=(0, 0, -1), low=0.0, high=1.0, speed=1.0, slides=True),
            Joint(xyz=(0, 0, -0.1), low=-pi, high=pi, speed=2.0),
            Joint(xyz=(0, 0, -0.1), axis=(1, 0, 0), low=-2.0, high=2.0, speed=2.0),
            Joint(xyz=(0, 0, -0.1), axis=(0, 1, 0), low=-2.0, high=2.0, speed=2.0),
        ),
        tool="tool",
        tool_xyz=(0, 0, -0.1),
        tool_rpy=(pi, 0, 0),
    ),
}


def urdf(name: str, *, radius: float = _RADIUS) -> str:
    """The URDF of an arm of :data:`ARMS`, its rods of a radius [m]."""
    arm = ARMS[name]
    lines = [f'<robot name="{name}">', '  <link name="base_link"/>']
    ends = [joint.xyz for joint in arm.joints[1:]] + [arm.tool_xyz]
    parent = "base_link"
    for k, (joint, end) in enumerate(zip(arm.joints, ends, strict=True), start=1):
        kind = "prismatic" if joint.slides else "revolute" if joint.high < inf else "continuous"
        limits = f' lower="{joint.low}" upper="{joint.high}"' if joint.high < inf else ""
        lines += [
            f'  <joint name="joint_{k}" type="{kind}">',
            f'    <parent link="{parent}"/><child link="link_{k}"/>',
            f"    {_origin(joint.xyz, joint.rpy)}",
            f'    <axis xyz="{_numbers(joint.axis)}"/>',
            f'    <limit effort="100" velocity="{joint.speed}"{limits}/>',
            "  </joint>",
            f'  <link name="link_{k}">',
            *(f"    <{use}>{_rod(end, radius)}</{use}>" for use in ("visual", "collision")),
            "  </link>",
        ]
        parent = f"link_{k}"
    lines += [
        f'  <joint name="{arm.tool}_joint" type="fixed">',
        f'    <parent link="{parent}"/><child link="{arm.tool}"/>',
        f"    {_origin(arm.tool_xyz, arm.tool_rpy)}",
        "  </joint>",
        f'  <link name="{arm.tool}"/>',
        "</robot>",
        "",
    ]
    return "\n".join(lines)


def _rod(end: tuple[float, float, float], radius: float) -> str:
    """A rod from the origin to a point, or a ball where that is near."""
    x, y, z = end
    length = hypot(x, y, z)
    if length < 2.0 * radius:
        return f'<origin xyz="0 0 0"/><geometry><sphere radius="{radius}"/></geometry>'
    rpy = (0.0, atan2(hypot(x, y), z), atan2(y, x))
    middle = (0.5 * x, 0.5 * y, 0.5 * z)
    shape = f'<cylinder radius="{radius}" length="{length:.6f}"/>'
    return f"{_origin(middle, rpy)}<geometry>{shape}</geometry>"


def _origin(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> str:
    return f'<origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/>'


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
