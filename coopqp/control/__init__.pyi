from .interface import (
    Controller as Controller,
)
from .interface import (
    ControlStep as ControlStep,
)
from .interface import (
    GivenUp as GivenUp,
)
from .interface import (
    SolverReport as SolverReport,
)
from .interface import (
    Status as Status,
)
from .lookahead.options import PreviewOptions as PreviewOptions
from .lookahead.preview import PathPreview as PathPreview
from .monitoring.options import SupervisionOptions as SupervisionOptions
from .monitoring.stall_bound import StallBound as StallBound
from .options import QPOptions as QPOptions
from .qp import QPController as QPController
from .step.constraint_set import Constraints as Constraints
from .step.formulations import (
    Pieces as Pieces,
)
from .step.formulations import (
    RankWeights as RankWeights,
)
from .step.formulations import (
    StepProgram as StepProgram,
)
from .step.formulations import (
    StepTerms as StepTerms,
)
from .step.linearised import LinearisedStep as LinearisedStep
from .step.plain import PlainLoop as PlainLoop
from .step.priorities import StepSolver as StepSolver
from .step.state import Proposal as Proposal
from .step.velocity_bounds import VelocityBox as VelocityBox
