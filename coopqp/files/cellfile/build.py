"""Building the objects of a run from a cell file."""

from __future__ import annotations

import contextlib
import importlib
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from pydantic import ValidationError

from coopqp.baselines.independent import IndependentQPController, IndependentQPOptions
from coopqp.baselines.pseudo_inverse import PseudoInverseController, PseudoInverseOptions
from coopqp.collision.clearance import Clearance
from coopqp.collision.scene import CollisionScene
from coopqp.control.interface import Controller
from coopqp.control.options import QPOptions
from coopqp.control.qp import QPController
from coopqp.drivers.driver import RobotDriver
from coopqp.drivers.engine import EngineCell
from coopqp.drivers.kinds import FOR_EVERY_ARM
from coopqp.drivers.timing import MonotonicTime
from coopqp.errors import CoopqpError, InvalidInputError, MissingExtraError, StartWarning, UnknownNameError
from coopqp.files.cellfile.bodies import build_scene
from coopqp.files.cellfile.build_arm import build_cell, build_placement, build_stiffness, in_radians
from coopqp.files.cellfile.build_drivers import make_drivers
from coopqp.files.cellfile.build_phases import build_program, first_pose
from coopqp.files.cellfile.error import CellFileError
from coopqp.files.cellfile.explain import explain, in_words_of_the_file
from coopqp.files.cellfile.path_tables import HoldTable, LineTable, TimedTable, WaypointsTable
from coopqp.files.cellfile.paths import folder_of
from coopqp.files.cellfile.schema import (
    MAX_STEPS,
    CellFile,
    CommonErrorTable,
    FreeTable,
    StartTable,
)
from coopqp.files.cellfile.search_tables import SearchTable
from coopqp.files.cellfile.searched import SearchTask, search_task
from coopqp.files.cellfile.sensors import build_disturbances, build_sensor
from coopqp.files.cellfile.strict import build_options
from coopqp.files.cellfile.text import read_tables
from coopqp.forces.wrist_sensor import SensorMaps, WristSensor
from coopqp.model.branches import amount
from coopqp.model.cell import RobotCell, slides
from coopqp.model.common_error import CommonError
from coopqp.model.free_directions import freed_cell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.model.shapes import Body, Box
from coopqp.paths.path import HoldPath, LinePath, ObjectPath, WaypointPath
from coopqp.paths.scenario import Scenario
from coopqp.paths.timed import TimedPath
from coopqp.planning.self_motion import led_path
from coopqp.planning.starts import find_start
from coopqp.simulation.evaluation.assessment import Tolerances
from coopqp.simulation.evaluation.closeness import default_scene, with_clearance
from coopqp.simulation.events import Operate, begin_as
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.simulation.plants.kinematic import DisturbedPlant, KinematicPlant, Plant
from coopqp.simulation.plants.physics import PhysicsPlant
from coopqp.simulation.plants.physics_options import PhysicsOptions
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import describe_object
from coopqp.simulation.simulate import ProgressCallback, refuse_for_plant, simulate
from coopqp.solvers.choice import default_solver
from coopqp.spatial import Array

DEFAULT_DT = 0.002
#: Names of the numbers of elbows in a file, and in their record.
ELBOWS = {"clocks_s": "clocks", "positions_rad": "x", "speeds_rad_per_s": "slopes"}
#: A start further than this from the positions of the file is told [rad], [m].
_NEAR_RAD, _NEAR_M = 0.35, 0.1

#: Class and options of every kind of controller.
CONTROLLERS: dict[str, tuple[Any, Any]] = {
    "qp": (QPController, QPOptions),
    "pseudo_inverse": (PseudoInverseController, PseudoInverseOptions),
    "independent": (IndependentQPController, IndependentQPOptions),
}
_SOLVER_SETTINGS = {"proxqp": "ProxqpSettings", "osqp": "OsqpSettings", "daqp": "DaqpSettings", "ldp": "LdpSettings"}


@dataclass(frozen=True, eq=False)
class CellTask:
    """The task of a cell file, before a start is found.

    Attributes:
        name: name of the task.
        cell, grasp, path: the arms, how they hold the object, and its path.
        q_start: the start of the file (nq,), or None if it is to be found.
        start_is_near: the start of the file is only near; inverse kinematics leads from it to the start.
        scene: the bodies that keep distances; None if the file has no such table.
        box: the object.
    """

    name: str
    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    q_start: Array | None
    start_is_near: bool
    scene: CollisionScene | None
    box: Body

    def exact_start(self) -> Array | None:
        """The configuration (nq,) at which the arms hold the object.

        Raises:
            UnreachableError: inverse kinematics does not lead to one.

        Warns:
            StartWarning: a joint is far from what the file gives.
        """
        if self.q_start is None or not self.start_is_near:
            return self.q_start
        q = inverse_kinematics(self.cell, self.grasp, self.path.pose(0.0), self.q_start)
        away = np.abs(pin.difference(self.cell.model, self.q_start, q))
        sliding = np.array(slides(self.cell))
        j = int((away / np.where(sliding, _NEAR_M, _NEAR_RAD)).argmax())
        if away[j] > (_NEAR_M if sliding[j] else _NEAR_RAD):
            arm, _, joint = self.cell.joint_names[j].rpartition("/")
            far = amount(away[j], slides=bool(sliding[j]))
            warnings.warn(
                f"start: arm {arm} takes hold with {joint} {far} from the positions that are given; give closer ones, "
                "or start.inverse_kinematics = false",
                StartWarning,
                stacklevel=2,
            )
        return q


@dataclass(frozen=True, eq=False)
class CellRun:
    """A run that a cell file describes, or one of a scenario with settings as in a cell file.

    Attributes:
        scenario: cell, grasp, path, start and object.
        controller_kind: ``"qp"``, ``"pseudo_inverse"`` or ``"independent"``.
        options: options dataclass of the controller.
        settle: time that the run continues after the end of the path [s].
        longest: longest run [s], or None.
        settings: contents of the file as plain data; its table ``output`` selects the files to write.
        disturbances: deviations of the plant from the ideal one; None for none.
        stiffness: what the file says of the joint servos (nv,) [N·m/rad or N/m]; None if it says nothing. The options
            of a controller ``"qp"`` have it; for :class:`coopqp.ForceOptions`.
        scene: the bodies whose distances are kept or checked; None without bodies.
        avoids: the controller keeps the margins of the scene.
        file: the file, for messages.
    """

    scenario: Scenario
    controller_kind: str
    options: Any
    settle: float
    longest: float | None
    settings: Any
    disturbances: Disturbances | None = None
    stiffness: Array | None = None
    scene: CollisionScene | None = None
    avoids: bool = False
    file: Path | None = None

    def controller(self) -> Controller:
        """A new controller."""
        s, more = self.scenario, {"constraints": [Clearance(self.scene)]} if self.scene and self.avoids else {}
        return CONTROLLERS[self.controller_kind][0](s.cell, s.grasp, s.path, dt=s.dt, options=self.options, **more)

    def led(self) -> CellRun:
        """The same run with its redundant arms led as its check proves; itself where nothing is proved or led."""
        if not isinstance(self.options, QPOptions) or self.options.preview is None:
            return self
        s, scene = self.scenario, self.scene if self.avoids else None
        path = led_path(s.cell, s.grasp, s.path, q_start=s.q_start, posture=self.options.posture, scene=scene)
        return replace(self, scenario=replace(s, path=path))

    def plant(self) -> Plant:
        """A new plant.

        Raises:
            MissingExtraError: the physics plant without MuJoCo.
        """
        s, disturbed = self.scenario, self.disturbances
        if self.settings.plant.kind == "physics":
            return self.physics_plant()
        return KinematicPlant(s.cell) if disturbed is None else DisturbedPlant(s.cell, s.grasp, disturbed)

    def physics_plant(self) -> PhysicsPlant:
        """A new physics plant: the file's, or one with default settings where the file asks for the kinematic one.

        Raises:
            MissingExtraError: MuJoCo is not installed.
        """
        table = self.settings.plant
        options = build_options(PhysicsOptions, table) if table.kind == "physics" else None
        return PhysicsPlant.of(self.scenario, options=options, disturbances=self.disturbances)

    def drivers(self, kind: str | None = None) -> dict[str, RobotDriver]:
        """A new driver for each robot, as the file's tables say.

        Args:
            kind: this kind for every robot, in place of those of the file, whose settings stay where they are of this
                kind: ``sim``, robots in simulation that stand at the start; ``engine``, robots in the physics engine
                that hold the object there and tell their wrenches.

        Raises:
            CellFileError: a robot without a driver, a driver without a robot, or one that does not fit its robot.
            MissingExtraError: a kind whose extra is not installed.
            UnknownNameError: no such kind.
        """
        if kind is not None and kind not in FOR_EVERY_ARM:
            raise UnknownNameError("driver", str(kind), FOR_EVERY_ARM, "drive")
        if kind == "engine":
            s = self.scenario
            engine = EngineCell(self.physics_plant(), s.q_start, time=MonotonicTime(), period=s.dt, lags=0.0)
            return dict(engine.robots())
        return make_drivers(self.scenario.cell, self.settings.drivers, self.scenario.q_start, kind, self.file)

    @property
    def sensors(self) -> dict[str, WristSensor]:
        """What the file says of the wrist sensors, by arm; for :class:`coopqp.ForceOptions`."""
        return known_sensors(self.settings)

    def metadata(self) -> dict[str, Any]:
        """What its recordings say of it."""
        s = self.scenario
        return {
            "scenario": s.name,
            "method": self.controller_kind,
            "object": describe_object(s.object_size, s.T_object_body),
            "settings": self.settings.model_dump(mode="json", exclude_none=True, exclude_unset=True),
        }

    def run(
        self,
        *,
        progress: ProgressCallback | None = None,
        operate: Operate | None = None,
        begun: dict[str, Any] | None = None,
    ) -> Recording:
        """Run the controller on the plant.

        Args:
            progress, operate: as in :func:`coopqp.simulate`.
            begun: override and pause at the start, as of :func:`coopqp.simulation.events.begin_as`.

        Raises:
            CellFileError: the controller refuses the start.
        """
        s = self.scenario
        try:
            controller = self.led().controller()
            begin_as(controller, begun)
            recording = simulate(
                controller,
                self.plant(),
                q_start=s.q_start,
                duration=self.longest,
                settle=self.settle,
                patience=self.settings.patience_s,
                progress=progress,
                operate=operate,
                metadata=self.metadata(),
            )
            return with_clearance(recording, self.scene, avoided=self.avoids)
        except InvalidInputError as error:
            raise CellFileError(f"{self.file or s.name}: {in_words_of_the_file(str(error))}") from error


def read(file: Path) -> CellFile:
    """Read and check a cell file. Builds nothing.

    Raises:
        CellFileError: as in :func:`read_tables`, or the file breaks the schema.
    """
    data = read_tables(file)
    try:
        return CellFile.model_validate(data)
    except ValidationError as error:
        raise CellFileError(f"{file}: {explain(error)}") from error


def load(file: Path) -> CellRun:
    """Read a cell file, build its objects, and test its controller. Every error names the file."""
    settings = read(file)
    with _errors_of(file):
        run = replace(build(settings, folder_of(file)), file=file)
        run.controller()
        refuse_for_plant(run.scenario.path, run.plant())
        SensorMaps(run.scenario.cell, run.sensors).check()
    return run


def load_task(file: Path) -> CellTask:
    """Read the task of a cell file. The start is None if it is to be searched. Every error names the file."""
    settings = read(file)
    with _errors_of(file):
        return _task(settings, folder_of(file))


@contextlib.contextmanager
def _errors_of(file: Path) -> Iterator[None]:
    """Errors of the library become errors of the file, in its words."""
    try:
        yield
    except (CellFileError, MissingExtraError):
        raise
    except CoopqpError as error:
        raise CellFileError(f"{file}: {in_words_of_the_file(str(error))}") from error


def load_search(file: Path) -> tuple[CellFile, SearchTask]:
    """Read a cell file, and the search for a way round in it: its own, or one between the ends of its path."""
    settings = read(file)
    with _errors_of(file):
        if settings.phases:
            raise CoopqpError("no way round is searched for phases: give the path of one phase, in a file of its own.")
        return settings, _parts(settings, folder_of(file)).search()


class _Parts(NamedTuple):
    """A task whose path may have to be searched. The path is None then."""

    file: CellFile
    cell: RobotCell
    grasp: Grasp
    path: ObjectPath | None
    q_start: Array | None
    near: bool
    scene: CollisionScene | None
    box: Body

    def search(self) -> SearchTask:
        """The search for a way round."""
        return search_task(
            self.file.path, self.path, self.cell, self.grasp, self.q_start, self.scene, is_near=self.near
        )


def _task(file: CellFile, folder: Path) -> CellTask:
    """The arms, their grasp, the path, and the start; errors name the arm or table."""
    _, cell, grasp, path, q_start, near, scene, box = parts = _parts(file, folder)
    if path is None:
        search = parts.search()
        route = search.route()
        path, near = search.path(route), False
        q_start = None if route.check is None else route.check.q_start
    return CellTask(file.name, cell, grasp, path, q_start, start_is_near=near, scene=scene, box=box)


def _parts(file: CellFile, folder: Path) -> _Parts:
    """The task, without a search."""
    build_options(Tolerances, file.verdict)  # a bad one is refused before any work is done
    cell = build_cell(file.arms, file.robots, folder)
    path: ObjectPath | None = None
    if isinstance(file.path, SearchTable):
        T_start = build_placement(file.path.start)
    elif file.path is None:
        T_start = first_pose(file.phases, _path)
    else:
        path = _path(file.path)
        T_start = path.pose(0.0)
    q_start = None if file.start.is_auto else _start(file.start, cell)
    latched = file.grasp.kind == "latched"
    if not latched:
        grasp = _grasp(file, cell)
    elif q_start is not None:
        grasp = Grasp.from_configuration(cell, q_start, T_start)
    else:
        raise CoopqpError(
            "a latched grasp follows from the start, so no start can be found for it: give start.positions_deg or "
            "start.positions_rad, or another kind of grasp."
        )
    if file.grasp.free:
        freed = freed_cell(cell, _freed(grasp, file.grasp.free))
        if q_start is not None:
            q_start = freed.configuration(cell.positions(q_start))
        cell, grasp = freed.cell, freed.grasp
    near = q_start is not None and file.start.inverse_kinematics and not latched
    box = Body("object", Box(file.object.size_m), build_placement(file.object.centre))
    table = file.collision
    scene = None if table is None else build_scene(table, cell, grasp, box, folder, build_placement)
    if file.path is None:
        path = build_program(file, cell, grasp, q_start, scene, _path)
    return _Parts(file, cell, grasp, path, q_start, near, scene, box)


def build(file: CellFile, folder: Path) -> CellRun:
    """Build the objects of a cell file. Its paths are relative to ``folder``. Errors name the arm or table."""
    task = _task(file, folder)
    cell, grasp, path = task.cell, task.grasp, task.path
    given = task.exact_start()
    q_start = find_start(cell, grasp, path, scene=task.scene).q if given is None else given
    dt = path.duration / file.steps if file.steps is not None else file.dt_s or DEFAULT_DT
    longest = file.longest_s if file.longest_s is not None else 10.0 * path.duration
    if (longest + file.settle_s) / dt > 10.0 * MAX_STEPS:
        raise CoopqpError(
            f"a run of up to {longest:g} s in steps of {dt:g} s is too long; raise dt_s or lower longest_s."
        )
    size = file.object.size_m
    scenario = Scenario(
        name=file.name,
        cell=cell,
        grasp=grasp,
        path=path,
        q_start=q_start,
        dt=dt,
        object_size=(size[0], size[1], size[2]),
        T_object_body=build_placement(file.object.centre),
        object_mass=file.object.mass_kg,
        obstacles=() if task.scene is None else tuple(task.scene.obstacles),
    )
    scene = default_scene(scenario) if task.scene is None else task.scene
    kind = str(file.controller.kind)
    options, stiffness = controller_options(kind, file.controller), build_stiffness(file.arms, cell)
    if stiffness is not None and kind == "qp":
        options = replace(options, supervision=replace(options.supervision, stiffness=tuple(stiffness.tolist())))
    disturbances = None if file.disturbances is None else build_disturbances(file.disturbances)
    avoids = file.collision is not None and file.collision.avoid
    return CellRun(scenario, kind, options, file.settle_s, file.longest_s, file, disturbances, stiffness, scene, avoids)


def _by_name(given: Mapping[str, Any], names: Sequence[str], where: str) -> list[Any]:
    """The values of a table with one key per arm (or robot), in their order. Each must have a key."""
    for name in given:
        if name not in names:
            raise UnknownNameError("arm", name, names, where)
    missing = [name for name in names if name not in given]
    if missing:
        raise CoopqpError(f"{where}: arm '{missing[0]}' is missing.")
    return [given[name] for name in names]


def _start(table: StartTable, cell: RobotCell) -> Array:
    degrees = table.positions_deg is not None
    where = f"start.positions_{'deg' if degrees else 'rad'}"
    blocks = cell.blocks
    values = _by_name(table.positions_deg or table.positions_rad or {}, tuple(blocks), where)
    sliding = slides(cell)
    parts = []
    for (name, own), numbers in zip(blocks.items(), values, strict=True):
        parts.append(in_radians(numbers, sliding[own], f"{where}.{name}", degrees=degrees))
    return cell.configuration(np.concatenate(parts))


def _grasp(file: CellFile, cell: RobotCell) -> Grasp:
    if file.grasp.kind == "triangle":
        grasp = Grasp.triangle(file.grasp.alpha_m, file.grasp.beta_m)
        grasp.check_arms(cell)
        return grasp
    assert file.grasp.kind == "tools"
    return Grasp(tuple(build_placement(tool) for tool in _by_name(file.grasp.tools, cell.arm_names, "grasp.tools")))


def _freed(grasp: Grasp, tables: Sequence[FreeTable]) -> Grasp:
    """A grasp that gives way as the tables say."""
    for table in tables:
        degrees = table.range_deg is not None
        low, high = table.range_deg or table.range_rad or table.range_m or (0.0, 0.0)
        ends = (math.radians(low), math.radians(high)) if degrees else (low, high)
        grasp = grasp.freed(table.arm, table.axis, range=ends)
    return grasp


def _path(path: LineTable | WaypointsTable | HoldTable | TimedTable) -> ObjectPath:
    if path.kind == "timed":
        names = {"pieces": path.pieces, "s": path.s_m, "squares": path.squares, "planned_share": path.planned_share}
        names["keeps_clear"] = path.keeps_clear
        if path.elbows is not None:
            names["elbows"] = {own: getattr(path.elbows, name) for name, own in ELBOWS.items()}
        names["binding"] = [section.model_dump() for section in path.binding]
        return TimedPath.of_record(names)
    if path.kind == "hold":
        return HoldPath(build_placement(path.pose), duration=path.duration_s)
    if path.kind == "waypoints":
        poses = [build_placement(pose) for pose in path.poses]
        return WaypointPath(poses, durations=path.durations_s, time_law=path.time_law)
    start = build_placement(path.start)
    if path.goal is not None:
        return LinePath(start, build_placement(path.goal), duration=path.duration_s, time_law=path.time_law)
    assert path.displacement is not None
    return LinePath.displaced(
        start,
        translation=path.displacement.translation_m,
        rotation=np.deg2rad(path.displacement.rotation_vector_deg),
        duration=path.duration_s,
        time_law=path.time_law,
    )


def controller_options(kind: str, table: Any) -> Any:
    """The options of a controller of :data:`CONTROLLERS` from its table."""
    replaced: dict[str, Any] = {}
    if getattr(table, "solver_settings", None) is not None:
        default = CONTROLLERS[kind][1]().solver
        chosen = table.solver or default
        replaced["solver_settings"] = _solver_settings(
            default_solver() if chosen == "auto" else chosen, table.solver_settings
        )
    if isinstance(getattr(table, "common_error", None), CommonErrorTable):
        replaced["common_error"] = _common_error(table.common_error)
    return build_options(CONTROLLERS[kind][1], table, **replaced)


def _solver_settings(solver: str, given: Mapping[str, Any]) -> Any:
    """The settings object of a QP solver."""
    name = _SOLVER_SETTINGS.get(solver, "GenericSettings")
    settings = getattr(importlib.import_module("coopqp.solvers"), name)
    known = {entry.name for entry in fields(settings)} - {"options"}
    for key in given:
        if key not in known | settings.removed.keys():
            raise UnknownNameError("setting", key, known, name)
    return settings(**given)


def _common_error(table: CommonErrorTable) -> CommonError:
    if table.kind == "leader":
        return CommonError.leader(str(table.leader))
    if table.kind == "driver":
        return CommonError.driver(leader=str(table.leader), driver=str(table.driver))
    return CommonError.leaderless() if table.kind == "leaderless" else CommonError.per_axis(table.weights or [])


def known_sensors(file: CellFile) -> dict[str, WristSensor]:
    """What the file says of the sensors, by arm."""
    return {arm.name: build_sensor(arm.sensor) for arm in file.arms if arm.sensor is not None}
