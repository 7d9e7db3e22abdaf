from .base import Outcome as Outcome, QpSolver as QpSolver, SolverSettings as SolverSettings, Workspace as Workspace
from .choice import available_solvers as available_solvers, default_solver as default_solver, make_solver as make_solver
from .daqp import DaqpSettings as DaqpSettings
from .generic import GenericSettings as GenericSettings, GenericSolver as GenericSolver
from .ldp import LdpSettings as LdpSettings
from .osqp import OsqpSettings as OsqpSettings
from .problem import QpProblem as QpProblem, QpSolution as QpSolution, SolverStatus as SolverStatus
from .proxqp import ProxqpSettings as ProxqpSettings
