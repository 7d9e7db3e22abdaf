"""The keys of a cell file. Units are in the names: ``_m`` metres, ``_deg`` degrees, ``_rad`` radians, ``_s`` seconds.

Prismatic joints use metres (m/s, m/s²) under the keys of either angle unit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from annotated_types import Ge, Le, Len
from pydantic import AfterValidator, Field, field_validator, model_validator

from coopqp.baselines.independent import IndependentQPOptions
from coopqp.baselines.pseudo_inverse import PseudoInverseOptions
from coopqp.control.options import QPOptions
from coopqp.drivers.kinds import DRIVER_KINDS
from coopqp.drivers.ros2_board import Ros2BoardOptions
from coopqp.errors import shown
from coopqp.files.cellfile.basic import (
    MAX_ARMS,
    Angle,
    Degrees,
    FilePath,
    Metres,
    Name,
    PerJoint,
    PlacementTable,
    Seconds,
    Sides,
    Stiffness,
    at_most_one,
    exactly_one,
)
from coopqp.files.cellfile.bodies import CollisionTable
from coopqp.files.cellfile.path_tables import HoldTable, LineTable, TimedTable, WaypointsTable
from coopqp.files.cellfile.paths import check_inside
from coopqp.files.cellfile.phases import MAX_PHASES, AttachTable, PhaseTable
from coopqp.files.cellfile.search_tables import SearchTable
from coopqp.files.cellfile.sensors import DisturbancesTable, SensorTable
from coopqp.files.cellfile.strict import MAX_LIST, Number, Numbers, Table, problem, table_of
from coopqp.scenarios.arms import ROBOTS
from coopqp.scenarios.robots import SEVERAL_ARMS
from coopqp.simulation.evaluation.assessment import Tolerances
from coopqp.simulation.plants.physics_options import PhysicsOptions
from coopqp.simulation.simulate import PATIENCE

#: Largest accepted number of steps of a run.
MAX_STEPS = 1_000_000


class LimitsTable(Table):
    """Limits in place of the model's: one number for joints of one kind, or one per joint; ``inf`` means no limit."""

    lower_deg: PerJoint | None = Field(default=None, description="lowest position")
    upper_deg: PerJoint | None = Field(default=None, description="highest position")
    velocity_deg_per_s: PerJoint | None = Field(default=None, description="largest speed")
    acceleration_deg_per_s2: PerJoint | None = Field(default=None, description="largest acceleration")
    lower_rad: PerJoint | None = Field(default=None, description="the same in radians")
    upper_rad: PerJoint | None = Field(default=None, description="the same in radians")
    velocity_rad_per_s: PerJoint | None = Field(default=None, description="the same in radians")
    acceleration_rad_per_s2: PerJoint | None = Field(default=None, description="the same in radians")

    @model_validator(mode="after")
    def _one_unit(self) -> LimitsTable:
        for name, per in (("lower", ""), ("upper", ""), ("velocity", "_per_s"), ("acceleration", "_per_s2")):
            at_most_one(self, f"{name}_deg{per}", f"{name}_rad{per}")
        return self


class RobotTable(Table):
    """A robot with several arms, for example two arms on one torso, lift or rail: its model, its base, its limits.

    Its arms are tables [[arms]] with ``of``. Joints that move the tools of several arms get one command.
    """

    name: Name = Field(description="unique name, without '/': prefix of joints that its arms share")
    robot: Literal[tuple(SEVERAL_ARMS)] | None = Field(default=None, description="name of a robot that comes along")  # type: ignore[valid-type]
    urdf: FilePath | None = Field(
        default=None, description="URDF file: relative to this file, with ~ and $VARIABLES, or package://NAME/…"
    )
    geometry: bool = Field(default=True, description="read the shapes, for pictures")
    base: PlacementTable = Field(
        default_factory=PlacementTable, description="placement of the model's root in the world"
    )
    package_dirs: Annotated[list[FilePath], Len(0, 20)] = Field(
        default=[], description="folders that resolve package://, besides those above the URDF and those of ROS"
    )
    locked_joints_deg: dict[Name, Angle] = Field(default={}, description="joints to lock, with their positions")
    locked_joints_rad: dict[Name, Angle] = Field(default={}, description="the same in radians")
    limits: dict[Name, LimitsTable] = Field(
        default={}, description='limits in place of the model\'s, by joint; "*" for all joints that turn'
    )

    @field_validator("limits", mode="before")
    @classmethod
    def _by_joint(cls, value: Any) -> Any:
        quantities = LimitsTable.model_fields.keys() & value.keys() if isinstance(value, dict) else ()
        if quantities:
            raise problem(f"limits of a robot are by joint: give 'limits.\"*\".{min(quantities)}', or a joint's name")
        return value

    @model_validator(mode="after")
    def _one_model(self) -> RobotTable:
        exactly_one(self, "robot", "urdf")
        return self


#: Keys of an arm that are its robot's where it is the arm of one.
_OF_ROBOT = ("base", "geometry", "package_dirs", "locked_joints_deg", "locked_joints_rad", "limits")


class ArmTable(Table):
    """One arm: its model, its tool frame, the placement of its base, its limits."""

    name: Name = Field(description="unique name, without '/'")
    robot: Literal[tuple(ROBOTS)] | None = Field(default=None, description="name of a robot: `coopqp schema --robots`")  # type: ignore[valid-type]
    urdf: FilePath | None = Field(
        default=None, description="URDF file: relative to this file, with ~ and $VARIABLES, or package://NAME/…"
    )
    mjcf: FilePath | None = Field(default=None, description="MJCF file, in the same forms")
    of: Name | None = Field(default=None, description="name of the robot of [[robots]] whose arm it is")
    geometry: bool = Field(default=True, description="read the shapes, for pictures")
    tool_frame: Name | None = Field(
        default=None, description="link or frame that holds the object; optional with robot"
    )
    base: PlacementTable = Field(
        default_factory=PlacementTable, description="placement of the model's root in the world"
    )
    package_dirs: Annotated[list[FilePath], Len(0, 20)] = Field(
        default=[], description="folders that resolve package://, besides those above the URDF and those of ROS"
    )
    locked_joints_deg: dict[Name, Angle] = Field(default={}, description="joints to lock, with their positions")
    locked_joints_rad: dict[Name, Angle] = Field(default={}, description="the same in radians")
    limits: LimitsTable = Field(default_factory=LimitsTable, description="limits in place of the model's")
    stiffness_nm_per_rad: Stiffness | None = Field(
        default=None,
        description="Kp of its joint servos: one number, or one per joint (sliding joints: N/m). With it an arm that "
        "stops is seen by the force at the grasps: controller.supervision.force_limit",
    )
    sensor: SensorTable | None = Field(
        default=None, description="how its wrist sensor is known to read, as `coopqp sensors` writes it"
    )

    @model_validator(mode="after")
    def _one_model(self) -> ArmTable:
        if exactly_one(self, "robot", "urdf", "mjcf", "of") != "robot" and self.tool_frame is None:
            raise problem("tool_frame is missing: the link or frame that holds the object")
        given = [key for key in _OF_ROBOT if key in self.model_fields_set]
        if self.of is not None and given:
            raise problem(f"{given[0]} is the robot's: give it in [[robots]]")
        return self


#: Lowest and highest position of a free direction.
Ends = Annotated[list[Angle], Len(2, 2)]


class FreeTable(Table):
    """A direction in which the grasp of an arm gives way: a passive joint behind its tool."""

    arm: Name = Field(description="name of the arm")
    axis: Literal["x", "y", "z", "rx", "ry", "rz"] = Field(
        description="slide along, or turn about, an axis of its tool"
    )
    range_deg: Ends | None = Field(default=None, description="lowest and highest angle")
    range_rad: Ends | None = Field(default=None, description="the same in radians")
    range_m: Ends | None = Field(default=None, description="of a slide")

    @model_validator(mode="after")
    def _one_unit(self) -> FreeTable:
        given = exactly_one(self, "range_deg", "range_rad", "range_m")
        if (given == "range_m") is self.axis.startswith("r"):
            raise problem(f"axis '{self.axis}' takes {'range_deg or range_rad' if given == 'range_m' else 'range_m'}")
        return self


Frees = Annotated[list[FreeTable], Len(0, 6 * MAX_ARMS)]


class TriangleGrasp(Table):
    """The paper's grasp: tools at A (0, 0), B (−β, 3α), C (β, 3α); the object frame is the frame of A."""

    kind: Literal["triangle"]
    alpha_m: Metres = Field(description="α: a third of the triangle's height")
    beta_m: Metres = Field(description="β: half its base")
    free: Frees = Field(default=[], description="directions in which it gives way; three turns make a ball")


class ToolsGrasp(Table):
    """Placement of each tool on the object."""

    kind: Literal["tools"]
    tools: dict[Name, PlacementTable] = Field(description="placement of each arm's tool in the object frame, by arm")
    free: Frees = Field(default=[], description="directions in which it gives way; three turns make a ball")


class LatchedGrasp(Table):
    """The grasp follows from the tools at the start and the first pose of the path."""

    kind: Literal["latched"]
    free: Frees = Field(default=[], description="directions in which it gives way; three turns make a ball")


class StartTable(Table):
    """Start configuration of the arms; "auto", or a table without positions: coopqp finds it."""

    positions_deg: Degrees | None = Field(
        default=None, description="position of every joint, by arm; of joints that arms share by their robot"
    )
    positions_rad: Degrees | None = Field(default=None, description="the same in radians")
    inverse_kinematics: bool = Field(
        default=True,
        description="correct the positions so that the tools fit the grasp and the first pose exactly",
    )

    @model_validator(mode="before")
    @classmethod
    def _auto(cls, data: Any) -> Any:
        if isinstance(data, str):
            if data != "auto":
                raise problem('give a table or "auto"')
            return {}
        return data

    @model_validator(mode="after")
    def _one_unit(self) -> StartTable:
        at_most_one(self, "positions_deg", "positions_rad")
        return self

    @property
    def is_auto(self) -> bool:
        """No positions are given: a start has to be found."""
        return self.positions_deg is None and self.positions_rad is None


class ObjectTable(Table):
    """The box that represents the object in pictures and in the physics engine."""

    size_m: Sides = Field(default=[0.1, 0.1, 0.1], description="side lengths of the box")
    centre: PlacementTable = Field(default_factory=PlacementTable, description="centre of the box in the object frame")
    mass_kg: Annotated[float, Ge(1e-6), Le(1e6)] = Field(default=20.0, description="mass of the object")


class CommonErrorTable(Table):
    """Weights that define the object pose from the views of the arms."""

    removed = {"master": "Give leader."}  # noqa: RUF012  # of version 0.1

    kind: Literal["leader", "leaderless", "driver", "per_axis"] = Field(description="see coopqp.model.common_error")
    leader: Name | None = Field(
        default=None, description="arm that defines the object pose (kind leader) or its position (kind driver)"
    )
    driver: Name | None = Field(default=None, description="arm that orients the object (kind driver)")
    weights: Annotated[list[Annotated[list[float], Len(6, 6)]], Len(1, MAX_ARMS)] | None = Field(
        default=None, description="one row [x, y, z, rx, ry, rz] per arm (kind per_axis)"
    )

    @model_validator(mode="after")
    def _fits(self) -> CommonErrorTable:
        needed = {"leader": {"leader"}, "leaderless": set(), "driver": {"leader", "driver"}, "per_axis": {"weights"}}
        given = {key for key in ("leader", "driver", "weights") if getattr(self, key) is not None}
        if given != needed[self.kind]:
            wants = " and ".join(sorted(needed[self.kind])) or "nothing else"
            raise problem(f"kind '{self.kind}' takes {wants}")
        return self


_Settings = Annotated[dict[Name, Number | int | bool | str], Len(0, 50)]
_SOLVER = {"solver": Name, "solver_settings": _Settings}

QPTable = table_of(
    QPOptions,
    "QPTable",
    replaced={**_SOLVER, "common_error": CommonErrorTable},
    first={"kind": (Literal["qp"], ...)},
)
PseudoInverseTable = table_of(
    PseudoInverseOptions, "PseudoInverseTable", first={"kind": (Literal["pseudo_inverse"], ...)}
)
IndependentTable = table_of(
    IndependentQPOptions, "IndependentTable", replaced=_SOLVER, first={"kind": (Literal["independent"], ...)}
)


class KinematicTable(Table):
    """Joints that follow their commands exactly."""

    kind: Literal["kinematic"]


PhysicsTable = table_of(
    PhysicsOptions,
    "PhysicsTable",
    replaced=dict.fromkeys(("stiffness", "damping", "armature", "torque_limits"), Number | Numbers | Literal[False]),
    first={"kind": (Literal["physics"], ...)},
)

_DRIVER_TABLES = tuple(
    table_of(kind.options, f"{name.capitalize()}Table", first={"kind": (Literal[name], ...)})
    for name, kind in DRIVER_KINDS.items()
)

_Ros2Table = table_of(Ros2BoardOptions, "Ros2Table")

#: Largest accepted errors: the run fails beyond them.
_VerdictTable = table_of(Tolerances, "VerdictTable")

if TYPE_CHECKING:
    ControllerTable = Any  # built at run time from the options dataclasses
    PlantTable = Any
    VerdictTable = Any
    DriverTable = Any
    Ros2Table = Any
else:
    VerdictTable = _VerdictTable
    Ros2Table = _Ros2Table
    DriverTable = Annotated[Union[_DRIVER_TABLES], Field(discriminator="kind")]  # noqa: UP007  # of a tuple
    ControllerTable = Annotated[QPTable | PseudoInverseTable | IndependentTable, Field(discriminator="kind")]
    PlantTable = Annotated[KinematicTable | PhysicsTable, Field(discriminator="kind")]


def _inside(text: str) -> str:
    wrong = check_inside(text)
    if wrong:
        raise problem(f"{wrong}, not {shown(text)}")
    return text


class OutputTable(Table):
    """Files that a run writes into one folder."""

    folder: Annotated[FilePath, AfterValidator(_inside)] | None = Field(
        default=None, description="folder below the working directory (default out/NAME); a used one gets a number"
    )
    recording: bool = Field(default=True, description="recording.npz: input for view, report and export")
    report: bool = Field(default=False, description="report.html: figures, plots, settings and verdict")
    plots: bool = Field(default=False, description="timeline.png, joints.png, motion.png")
    page: bool = Field(default=False, description="view.html: the run in 3D, opens offline")
    csv: bool = Field(default=False, description="run.csv: one row per sample")
    bag: bool = Field(default=False, description="bag/: a ROS 2 bag (MCAP)")


class CellFile(Table):
    """A cell, its grasp, its path, and the controller, plant and output of a run."""

    name: Name = Field(description="name of the run")
    arms: Annotated[list[ArmTable], Len(1, MAX_ARMS)] = Field(description="one table per arm; the first is the leader")
    robots: Annotated[list[RobotTable], Len(0, MAX_ARMS)] = Field(
        default=[], description="one table per robot with several arms"
    )
    grasp: Annotated[TriangleGrasp | ToolsGrasp | LatchedGrasp, Field(discriminator="kind")] = Field(
        description="placements of the tools on the object"
    )
    path: (
        Annotated[LineTable | WaypointsTable | HoldTable | TimedTable | SearchTable, Field(discriminator="kind")] | None
    ) = Field(default=None, description="path of the object; or give phases")
    phases: Annotated[list[PhaseTable], Len(0, MAX_PHASES)] = Field(
        default=[],
        description="a program, in place of a path: in its phases arms let go, travel, work or open the part",
    )
    signals_s: dict[Name, Annotated[float, Ge(0.0), Le(1e5)]] = Field(
        default={}, description="when signals of phases come by themselves, after the start of a run"
    )
    attach: AttachTable = Field(
        default_factory=AttachTable, description="in phases: how far from its grasp a tool may be where it attaches"
    )
    start: StartTable = Field(
        default_factory=StartTable,
        description='start configuration of the arms; "auto" (default): coopqp finds one that follows the path',
    )
    object: ObjectTable = Field(default_factory=ObjectTable, description="the object")
    controller: ControllerTable = Field(
        default_factory=lambda: QPTable.model_validate({"kind": "qp"}),
        description="the controller: qp (default), pseudo_inverse or independent",
    )
    plant: PlantTable = Field(
        default_factory=lambda: KinematicTable(kind="kinematic"),
        description="the plant: kinematic (default) or physics (extra mujoco)",
    )
    disturbances: DisturbancesTable | None = Field(
        default=None, description="what the physics plant simulates besides the model"
    )
    dt_s: Seconds | None = Field(default=None, description="length of a step (default 0.002); or give steps")
    steps: Annotated[int, Ge(1), Le(MAX_STEPS)] | None = Field(
        default=None, description="number of steps of an unslowed run"
    )
    settle_s: Annotated[float, Ge(0.0), Le(1e5)] = Field(
        default=0.0, description="time that the run continues after the end"
    )
    patience_s: Seconds = Field(default=PATIENCE, description="time until a run with a stopped object ends")
    longest_s: Seconds | None = Field(default=None, description="longest run (default: ten times the path's duration)")
    collision: CollisionTable | None = Field(
        default=None, description="what the arms and the object keep away from; without it a run is only judged"
    )
    drivers: Annotated[dict[Name, DriverTable], Len(0, MAX_ARMS)] = Field(
        default={},
        description="the driver of each robot, by its name, or by that of its arm where it has one; for `coopqp drive`",
    )
    ros2: Ros2Table | None = Field(
        default=None, description="ROS 2 topics of `coopqp drive`: its status, the object's pose, a hand's targets"
    )
    verdict: VerdictTable = Field(
        default_factory=_VerdictTable, description="accepted errors; `coopqp run` ends with status 4 beyond them"
    )
    output: OutputTable = Field(default_factory=OutputTable, description="files that the run writes")

    @model_validator(mode="after")
    def _fits(self) -> CellFile:
        at_most_one(self, "dt_s", "steps")
        if self.path is None and not self.phases:
            raise problem("path is missing: the path of the object; or give phases")
        if self.path is not None and self.phases:
            raise problem("give path or phases, not both")
        if self.phases and self.controller.kind != "qp":
            raise problem("phases: only the controller qp follows a program")
        names, used = [robot.name for robot in self.robots], {arm.of for arm in self.arms}
        if len(set(names)) < len(names):
            raise problem("robots: two have one name")
        for arm in self.arms:
            if arm.of is not None and arm.of not in names:
                raise problem(f"arms: '{arm.name}' is of '{arm.of}', and there is no such robot in [[robots]]")
        for name in names:
            if name not in used:
                raise problem(f"robots: no arm is of '{name}'; give [[arms]] with of = \"{name}\"")
        if self.disturbances is not None and self.plant.kind != "physics":
            raise problem("disturbances: only the plant physics simulates them")
        if self.collision is not None and self.collision.avoid and self.controller.kind != "qp":
            raise problem("collision.avoid: only the controller qp avoids; with avoid = false a run is judged")
        return self


__all__ = ["MAX_ARMS", "MAX_LIST", "MAX_STEPS", "CellFile"]
