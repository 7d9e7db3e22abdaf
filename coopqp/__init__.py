"""QP-based cooperative control of several robot arms that hold one object."""

from coopqp.control.command import Controller, ControlStep, Status
from coopqp.control.core import available_kernels
from coopqp.control.forms import RankWeights
from coopqp.control.options import QPOptions
from coopqp.control.pseudo_inverse import PseudoInverseController, PseudoInverseOptions
from coopqp.control.qp import QPController
from coopqp.control.solvers import available_solvers
from coopqp.control.supervision import SupervisionOptions
from coopqp.errors import (
    CoopqpError,
    InvalidInputError,
    MissingExtraError,
    ModelError,
    UnknownNameError,
    UnreachableError,
)
from coopqp.forces.stress import StressModel
from coopqp.model.cell import Arm, JointLimits, RobotCell
from coopqp.model.grasp import Grasp, plate_from_centroid, plate_from_points
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.state import CellState
from coopqp.planning.preview import PreviewOptions
from coopqp.simulation.plants.kinematic import KinematicPlant, Plant
from coopqp.simulation.plants.physics import PhysicsOptions, PhysicsPlant
from coopqp.simulation.simulate import Recording, simulate
from coopqp.task.common_error import CommonError
from coopqp.task.path import HoldPath, LinePath, ObjectPath, ServoPath, TimeLaw, WaypointPath
from coopqp.task.posture import PostureOptions

__version__ = "0.1.0"

__all__ = [
    "Arm",
    "BindingLimit",
    "CellState",
    "CommonError",
    "ControlStep",
    "Controller",
    "CoopqpError",
    "Grasp",
    "HoldPath",
    "InvalidInputError",
    "JointLimits",
    "KinematicPlant",
    "LimitKind",
    "LinePath",
    "MissingExtraError",
    "ModelError",
    "ObjectPath",
    "PhysicsOptions",
    "PhysicsPlant",
    "Plant",
    "PostureOptions",
    "PreviewOptions",
    "PseudoInverseController",
    "PseudoInverseOptions",
    "QPController",
    "QPOptions",
    "RankWeights",
    "Recording",
    "RobotCell",
    "ServoPath",
    "Status",
    "StressModel",
    "SupervisionOptions",
    "TimeLaw",
    "UnknownNameError",
    "UnreachableError",
    "WaypointPath",
    "__version__",
    "available_kernels",
    "available_solvers",
    "inverse_kinematics",
    "plate_from_centroid",
    "plate_from_points",
    "simulate",
]
