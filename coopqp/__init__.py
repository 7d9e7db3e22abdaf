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
    from coopqp.baselines.independent import IndependentQPController, IndependentQPOptions
    from coopqp.baselines.pseudo_inverse import PseudoInverseController, PseudoInverseOptions
    from coopqp.constraints.cause import Cause
    from coopqp.constraints.rate import Knot, RateBound
    from coopqp.constraints.velocity import Rank, VelocityConstraint
    from coopqp.control.interface import Controller, ControlStep, GivenUp, SolverReport, Status
    from coopqp.control.lookahead.options import PreviewOptions
    from coopqp.control.monitoring.options import SupervisionOptions
    from coopqp.control.monitoring.stall_bound import StallBound
    from coopqp.control.options import QPOptions
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
    from coopqp.control.step.formulations import RankWeights
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
    from coopqp.forces.utilisation import LoadUse
    from coopqp.model.cell import Arm, JointLimits, RobotCell
    from coopqp.model.common_error import CommonError
    from coopqp.model.grasp import Grasp, plate_from_centroid, plate_from_points
    from coopqp.model.inverse_kinematics import inverse_kinematics
    from coopqp.model.limits import BindingLimit, LimitKind
    from coopqp.model.posture import PostureOptions
    from coopqp.model.state import CellState
    from coopqp.native import available_kernels
    from coopqp.output import OutputError
    from coopqp.paths.path import HoldPath, LinePath, ObjectPath, TimeLaw, WaypointPath
    from coopqp.paths.scenario import EngineSettings, Scenario
    from coopqp.paths.servo import ServoPath
    from coopqp.paths.timed import TimedPath
    from coopqp.scenarios.robots import robot_path
    from coopqp.simulation.evaluation.assessment import Finding, Tolerances, judge
    from coopqp.simulation.evaluation.calibration_runs import calibrate_runs
    from coopqp.simulation.evaluation.closeness import Closeness, Closest
    from coopqp.simulation.evaluation.metrics import (
        chain_error,
        limit_excess,
        object_error,
        path_error,
        relative_orientation_error,
        relative_positioning_error,
        tool_placements,
    )
    from coopqp.simulation.evaluation.monitor import Monitor, check_run
    from coopqp.simulation.evaluation.monitored import Monitored
    from coopqp.simulation.evaluation.readings import Readings, read_run
    from coopqp.simulation.evaluation.violations import Breach, MonitorTolerances, Verdict, Violation
    from coopqp.simulation.evaluation.wrench_bounds import WrenchBounds
    from coopqp.simulation.plants.disturbances import Disturbances, misplaced
    from coopqp.simulation.plants.disturbed import DisturbedPlant
    from coopqp.simulation.plants.kinematic import KinematicPlant, Plant
    from coopqp.simulation.plants.physics import PhysicsError, PhysicsPlant
    from coopqp.simulation.plants.physics_options import PhysicsOptions
    from coopqp.simulation.recording.recording import Recording, RecordingError
    from coopqp.simulation.recording.scene import SceneError, describe_object
    from coopqp.simulation.simulate import simulate
    from coopqp.spatial import Array, Placement, adjoint
    from coopqp.studies.errors import EngineError, StudyError
    from coopqp.visualization.calibration import write_calibration
    from coopqp.visualization.loads import write_load_use
    from coopqp.visualization.profile import write_speed_profile
    from coopqp.visualization.report import write_report
    from coopqp.visualization.viewer import LiveViewer, export_html
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.constraints.cause": "Cause",
            "coopqp.control.interface": "Controller ControlStep GivenUp SolverReport Status",
            "coopqp.constraints.velocity": "Rank VelocityConstraint",
            "coopqp.constraints.rate": "Knot RateBound",
            "coopqp.control.step.formulations": "RankWeights",
            "coopqp.control.options": "QPOptions",
            "coopqp.control.qp": "QPController",
            "coopqp.control.solvers": (
                "QpProblem QpSolution QpSolver SolverSettings SolverStatus available_solvers make_solver"
            ),
            "coopqp.control.monitoring.stall_bound": "StallBound",
            "coopqp.control.monitoring.options": "SupervisionOptions",
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
            "coopqp.control.lookahead.options": "PreviewOptions",
            "coopqp.simulation.plants.kinematic": "KinematicPlant Plant",
            "coopqp.simulation.evaluation.readings": "Readings read_run",
            "coopqp.simulation.recording.recording": "Recording RecordingError",
            "coopqp.simulation.simulate": "simulate",
            "coopqp.simulation.evaluation.violations": "Breach MonitorTolerances Verdict Violation",
            "coopqp.simulation.evaluation.wrench_bounds": "WrenchBounds",
            "coopqp.spatial": "Array Placement adjoint",
            "coopqp.model.common_error": "CommonError",
            "coopqp.paths.path": "HoldPath LinePath ObjectPath TimeLaw WaypointPath",
            "coopqp.model.posture": "PostureOptions",
            "coopqp.paths.scenario": "EngineSettings Scenario",
            "coopqp.paths.servo": "ServoPath",
            "coopqp.paths.timed": "TimedPath",
            "coopqp.baselines.independent": "IndependentQPController IndependentQPOptions",
            "coopqp.baselines.pseudo_inverse": "PseudoInverseController PseudoInverseOptions",
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
            "coopqp.forces.utilisation": "LoadUse",
            "coopqp.visualization.calibration": "write_calibration",
            "coopqp.visualization.loads": "write_load_use",
            "coopqp.visualization.profile": "write_speed_profile",
            "coopqp.visualization.report": "write_report",
            "coopqp.visualization.viewer": "LiveViewer export_html",
            "coopqp.output": "OutputError",
            "coopqp.scenarios.robots": "robot_path",
            "coopqp.simulation.evaluation.assessment": "Finding Tolerances judge",
            "coopqp.simulation.evaluation.calibration_runs": "calibrate_runs",
            "coopqp.simulation.evaluation.closeness": "Closeness Closest",
            "coopqp.simulation.evaluation.metrics": (
                "chain_error limit_excess object_error path_error relative_orientation_error "
                "relative_positioning_error tool_placements"
            ),
            "coopqp.simulation.evaluation.monitor": "Monitor check_run",
            "coopqp.simulation.evaluation.monitored": "Monitored",
            "coopqp.simulation.plants.disturbances": "Disturbances misplaced",
            "coopqp.simulation.plants.disturbed": "DisturbedPlant",
            "coopqp.simulation.plants.physics": "PhysicsError PhysicsPlant",
            "coopqp.simulation.plants.physics_options": "PhysicsOptions",
            "coopqp.simulation.recording.scene": "SceneError describe_object",
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
    "MonitorTolerances",
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
