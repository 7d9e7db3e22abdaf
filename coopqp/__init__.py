"""QP-based cooperative control of several robot arms that hold one object."""

from coopqp.cell import Arm, JointLimits, RobotCell
from coopqp.controllers.base import Controller, ControlStep, Status
from coopqp.controllers.common_error import CommonError
from coopqp.controllers.options import QPOptions
from coopqp.controllers.pseudo_inverse import PseudoInverseController, PseudoInverseOptions
from coopqp.controllers.qp import QPController
from coopqp.controllers.supervision import SupervisionOptions
from coopqp.errors import (
    CoopqpError,
    InvalidInputError,
    MissingExtraError,
    ModelError,
    UnknownNameError,
    UnreachableError,
)
from coopqp.grasp import Grasp, plate_from_centroid, plate_from_points
from coopqp.inverse_kinematics import inverse_kinematics
from coopqp.kernel import available_kernels
from coopqp.limits import BindingLimit, LimitKind
from coopqp.path import HoldPath, LinePath, ObjectPath, ServoPath, TimeLaw, WaypointPath
from coopqp.plants.kinematic import KinematicPlant, Plant
from coopqp.plants.physics import PhysicsOptions, PhysicsPlant
from coopqp.posture import PostureOptions
from coopqp.preview import PreviewOptions
from coopqp.program import RankWeights
from coopqp.simulation import Recording, simulate
from coopqp.solvers import available_solvers
from coopqp.state import CellState
from coopqp.stress import StressModel

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
