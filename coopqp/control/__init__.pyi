from .coupling import Coupling as Coupling, couple as couple
from .interface import (
    Controller as Controller,
    ControlStep as ControlStep,
    GivenUp as GivenUp,
    SolverReport as SolverReport,
    Status as Status,
)
from .lookahead.options import PreviewOptions as PreviewOptions
from .lookahead.preview import PathPreview as PathPreview
from .monitoring.options import SupervisionOptions as SupervisionOptions
from .monitoring.stall_bound import StallBound as StallBound
from .operator.calls import OperatorCalls as OperatorCalls
from .options import QPOptions as QPOptions
from .qp import QPController as QPController
from .step.constraint_set import Constraints as Constraints
from .step.formulations import (
    Pieces as Pieces,
    RankWeights as RankWeights,
    StepProgram as StepProgram,
    StepTerms as StepTerms,
)
from .step.linearised import LinearisedStep as LinearisedStep
from .step.plain import PlainLoop as PlainLoop
from .step.priorities import StepSolver as StepSolver
from .step.state import Proposal as Proposal
from .step.velocity_bounds import VelocityBox as VelocityBox
