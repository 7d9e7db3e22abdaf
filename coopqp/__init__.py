"""QP-based cooperative control of several robot arms that hold one object.

Each room of the package is one part of the flow:

* ``model``: the arms, the cell, the grasp, the closed chain;
* ``task``: the path of the object, the weights of the arms, the posture;
* ``planning``: before the motion starts and the check of a path; in motion the look ahead of the object's clock;
* ``control``: one step, from the measured configuration to the command;
* ``collision``: shapes, pairs and distances, and the constraint that keeps them;
* ``forces``: the wrenches between the arms and the object;
* ``simulation``: plants, the loop, recordings and their assessment;
* ``scenarios``: ready cells and tasks;
* ``files``: cell files and exports;
* ``studies``: many runs, and where bases may stand;
* ``look``, ``app``: pictures, the command ``coopqp``.

A room imports only from itself, from the rooms before it, and from ``errors``, ``native``, ``checks``, ``spatial``,
``output`` and ``lazy``. Import public names from :mod:`coopqp`, ready cells and tasks from :mod:`coopqp.scenarios`.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.control.cause import Cause
    from coopqp.control.command import Controller, ControlStep, GivenUp, SolverReport, Status
    from coopqp.control.constraints import Rank, VelocityConstraint
    from coopqp.control.forms import RankWeights
    from coopqp.control.independent import IndependentQPController, IndependentQPOptions
    from coopqp.control.options import QPOptions
    from coopqp.control.pseudo_inverse import PseudoInverseController, PseudoInverseOptions
    from coopqp.control.qp import QPController
    from coopqp.control.solvers import (
        QpProblem,
        QpSolution,
        QpSolver,
        SolverSettings,
        SolverStatus,
        available_solvers,
        make_solver,
    )
    from coopqp.control.solvers.daqp import DaqpSettings
    from coopqp.control.solvers.generic import GenericSettings
    from coopqp.control.solvers.ldp import LdpSettings
    from coopqp.control.solvers.osqp import OsqpSettings
    from coopqp.control.solvers.proxqp import ProxqpSettings
    from coopqp.control.stall_bound import StallBound
    from coopqp.control.supervision_options import SupervisionOptions
    from coopqp.errors import (
        BusyError,
        CoopqpError,
        InvalidInputError,
        KernelWarning,
        MissingExtraError,
        MissingSolverError,
        ModelError,
        NoStartError,
        StartWarning,
        StiffnessWarning,
        TooCloseError,
        UndecidedError,
        UnknownNameError,
        UnreachableError,
    )
    from coopqp.files.cellfile import CellFileError, load_cell_file
    from coopqp.files.export import write_bag, write_csv
    from coopqp.forces.calibration import Calibration, CalibrationError, CalibrationOptions, calibrate
    from coopqp.forces.force_controller import ForceController
    from coopqp.forces.force_options import ForceOptions
    from coopqp.forces.stress import InternalStress, StressModel, at_tools
    from coopqp.forces.use import LoadUse
    from coopqp.look.calibration import write_calibration
    from coopqp.look.loads import write_load_use
    from coopqp.look.profile import write_speed_profile
    from coopqp.look.report import write_report
    from coopqp.look.viewer import LiveViewer, export_html
    from coopqp.model.cell import Arm, JointLimits, RobotCell
    from coopqp.model.grasp import Grasp, plate_from_centroid, plate_from_points
    from coopqp.model.inverse_kinematics import inverse_kinematics
    from coopqp.model.limits import BindingLimit, LimitKind
    from coopqp.model.state import CellState
    from coopqp.native import available_kernels
    from coopqp.output import OutputError
    from coopqp.planning.preview_options import PreviewOptions
    from coopqp.planning.rate_bounds import Knot, RateBound
    from coopqp.scenarios.robots import robot_path
    from coopqp.simulation.assessment import Finding, Tolerances, judge
    from coopqp.simulation.calibrating import calibrate_runs
    from coopqp.simulation.closeness import Closeness, Closest
    from coopqp.simulation.metrics import (
        chain_error,
        limit_excess,
        object_error,
        path_error,
        relative_orientation_error,
        relative_positioning_error,
        tool_placements,
    )
    from coopqp.simulation.monitor import Monitor, check_run
    from coopqp.simulation.monitored import Monitored
    from coopqp.simulation.plants.disturbances import Disturbances, misplaced
    from coopqp.simulation.plants.disturbed import DisturbedPlant
    from coopqp.simulation.plants.kinematic import KinematicPlant, Plant
    from coopqp.simulation.plants.physics import PhysicsError, PhysicsPlant
    from coopqp.simulation.plants.physics_options import PhysicsOptions
    from coopqp.simulation.readings import Readings, read_run
    from coopqp.simulation.recording import Recording, RecordingError
    from coopqp.simulation.scene import SceneError, describe_object
    from coopqp.simulation.simulate import simulate
    from coopqp.simulation.violations import Breach, Verdict, Violation
    from coopqp.simulation.wrench_bounds import WrenchBounds
    from coopqp.spatial import Array, Placement, adjoint
    from coopqp.studies.errors import EngineError, StudyError
    from coopqp.task.common_error import CommonError
    from coopqp.task.path import HoldPath, LinePath, ObjectPath, TimeLaw, WaypointPath
    from coopqp.task.posture import PostureOptions
    from coopqp.task.scenario import EngineSettings, Scenario
    from coopqp.task.servo import ServoPath
    from coopqp.task.timed import TimedPath
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.control.cause": "Cause",
            "coopqp.control.command": "Controller ControlStep GivenUp SolverReport Status",
            "coopqp.control.constraints": "Rank VelocityConstraint",
            "coopqp.planning.rate_bounds": "Knot RateBound",
            "coopqp.control.forms": "RankWeights",
            "coopqp.control.options": "QPOptions",
            "coopqp.control.qp": "QPController",
            "coopqp.control.solvers": (
                "QpProblem QpSolution QpSolver SolverSettings SolverStatus available_solvers make_solver"
            ),
            "coopqp.control.stall_bound": "StallBound",
            "coopqp.control.supervision_options": "SupervisionOptions",
            "coopqp.errors": (
                "BusyError CoopqpError InvalidInputError KernelWarning MissingExtraError MissingSolverError "
                "ModelError NoStartError StartWarning StiffnessWarning TooCloseError UndecidedError "
                "UnknownNameError UnreachableError"
            ),
            "coopqp.model.cell": "Arm JointLimits RobotCell",
            "coopqp.model.grasp": "Grasp plate_from_centroid plate_from_points",
            "coopqp.model.inverse_kinematics": "inverse_kinematics",
            "coopqp.model.limits": "BindingLimit LimitKind",
            "coopqp.model.state": "CellState",
            "coopqp.native": "available_kernels",
            "coopqp.planning.preview_options": "PreviewOptions",
            "coopqp.simulation.plants.kinematic": "KinematicPlant Plant",
            "coopqp.simulation.readings": "Readings read_run",
            "coopqp.simulation.recording": "Recording RecordingError",
            "coopqp.simulation.simulate": "simulate",
            "coopqp.simulation.violations": "Breach Verdict Violation",
            "coopqp.simulation.wrench_bounds": "WrenchBounds",
            "coopqp.spatial": "Array Placement adjoint",
            "coopqp.task.common_error": "CommonError",
            "coopqp.task.path": "HoldPath LinePath ObjectPath TimeLaw WaypointPath",
            "coopqp.task.posture": "PostureOptions",
            "coopqp.task.scenario": "EngineSettings Scenario",
            "coopqp.task.servo": "ServoPath",
            "coopqp.task.timed": "TimedPath",
            "coopqp.control.independent": "IndependentQPController IndependentQPOptions",
            "coopqp.control.pseudo_inverse": "PseudoInverseController PseudoInverseOptions",
            "coopqp.control.solvers.daqp": "DaqpSettings",
            "coopqp.control.solvers.generic": "GenericSettings",
            "coopqp.control.solvers.ldp": "LdpSettings",
            "coopqp.control.solvers.osqp": "OsqpSettings",
            "coopqp.control.solvers.proxqp": "ProxqpSettings",
            "coopqp.files.cellfile": "CellFileError load_cell_file",
            "coopqp.files.export": "write_bag write_csv",
            "coopqp.forces.calibration": "Calibration CalibrationError CalibrationOptions calibrate",
            "coopqp.forces.force_controller": "ForceController",
            "coopqp.forces.force_options": "ForceOptions",
            "coopqp.forces.stress": "InternalStress StressModel at_tools",
            "coopqp.forces.use": "LoadUse",
            "coopqp.look.calibration": "write_calibration",
            "coopqp.look.loads": "write_load_use",
            "coopqp.look.profile": "write_speed_profile",
            "coopqp.look.report": "write_report",
            "coopqp.look.viewer": "LiveViewer export_html",
            "coopqp.output": "OutputError",
            "coopqp.scenarios.robots": "robot_path",
            "coopqp.simulation.assessment": "Finding Tolerances judge",
            "coopqp.simulation.calibrating": "calibrate_runs",
            "coopqp.simulation.closeness": "Closeness Closest",
            "coopqp.simulation.metrics": (
                "chain_error limit_excess object_error path_error relative_orientation_error "
                "relative_positioning_error tool_placements"
            ),
            "coopqp.simulation.monitor": "Monitor check_run",
            "coopqp.simulation.monitored": "Monitored",
            "coopqp.simulation.plants.disturbances": "Disturbances misplaced",
            "coopqp.simulation.plants.disturbed": "DisturbedPlant",
            "coopqp.simulation.plants.physics": "PhysicsError PhysicsPlant",
            "coopqp.simulation.plants.physics_options": "PhysicsOptions",
            "coopqp.simulation.scene": "SceneError describe_object",
            "coopqp.studies.errors": "EngineError StudyError",
        },
    )

__version__ = "0.1.0"

__all__ = [
    "Arm",
    "Array",
    "BindingLimit",
    "Breach",
    "BusyError",
    "Calibration",
    "CalibrationError",
    "CalibrationOptions",
    "Cause",
    "CellFileError",
    "CellState",
    "Closeness",
    "Closest",
    "CommonError",
    "ControlStep",
    "Controller",
    "CoopqpError",
    "DaqpSettings",
    "Disturbances",
    "DisturbedPlant",
    "EngineError",
    "EngineSettings",
    "Finding",
    "ForceController",
    "ForceOptions",
    "GenericSettings",
    "GivenUp",
    "Grasp",
    "HoldPath",
    "IndependentQPController",
    "IndependentQPOptions",
    "InternalStress",
    "InvalidInputError",
    "JointLimits",
    "KernelWarning",
    "KinematicPlant",
    "Knot",
    "LdpSettings",
    "LimitKind",
    "LinePath",
    "LiveViewer",
    "LoadUse",
    "MissingExtraError",
    "MissingSolverError",
    "ModelError",
    "Monitor",
    "Monitored",
    "NoStartError",
    "ObjectPath",
    "OsqpSettings",
    "OutputError",
    "PhysicsError",
    "PhysicsOptions",
    "PhysicsPlant",
    "Placement",
    "Plant",
    "PostureOptions",
    "PreviewOptions",
    "ProxqpSettings",
    "PseudoInverseController",
    "PseudoInverseOptions",
    "QPController",
    "QPOptions",
    "QpProblem",
    "QpSolution",
    "QpSolver",
    "Rank",
    "RankWeights",
    "RateBound",
    "Readings",
    "Recording",
    "RecordingError",
    "RobotCell",
    "Scenario",
    "SceneError",
    "ServoPath",
    "SolverReport",
    "SolverSettings",
    "SolverStatus",
    "StallBound",
    "StartWarning",
    "Status",
    "StiffnessWarning",
    "StressModel",
    "StudyError",
    "SupervisionOptions",
    "TimeLaw",
    "TimedPath",
    "Tolerances",
    "TooCloseError",
    "UndecidedError",
    "UnknownNameError",
    "UnreachableError",
    "VelocityConstraint",
    "Verdict",
    "Violation",
    "WaypointPath",
    "WrenchBounds",
    "__version__",
    "adjoint",
    "at_tools",
    "available_kernels",
    "available_solvers",
    "calibrate",
    "calibrate_runs",
    "chain_error",
    "check_run",
    "describe_object",
    "export_html",
    "inverse_kinematics",
    "judge",
    "limit_excess",
    "load_cell_file",
    "make_solver",
    "misplaced",
    "object_error",
    "path_error",
    "plate_from_centroid",
    "plate_from_points",
    "read_run",
    "relative_orientation_error",
    "relative_positioning_error",
    "robot_path",
    "simulate",
    "tool_placements",
    "write_bag",
    "write_calibration",
    "write_csv",
    "write_load_use",
    "write_report",
    "write_speed_profile",
]
