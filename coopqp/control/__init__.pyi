from .coupling import Coupling as Coupling, couple as couple
from .interface import (
    Controller as Controller,
    ControlStep as ControlStep,
    GivenUp as GivenUp,
    SolverReport as SolverReport,
    Status as Status,
)
from .lookahead.options import PreviewOptions as PreviewOptions
from .monitoring.options import SupervisionOptions as SupervisionOptions
from .monitoring.stall_bound import StallBound as StallBound
from .operator.calls import OperatorCalls as OperatorCalls
from .options import QPOptions as QPOptions, RankWeights as RankWeights
from .qp import QPController as QPController
from .step.constraint_set import Constraints as Constraints
from .step.other_solver import StepProgram as StepProgram, StepSolver as StepSolver
from .step.velocity_bounds import VelocityBox as VelocityBox
