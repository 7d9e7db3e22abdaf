from .base import Outcome as Outcome, QpSolver as QpSolver, SolverSettings as SolverSettings
from .choice import available_solvers as available_solvers, default_solver as default_solver, make_solver as make_solver
from .generic import DaqpSettings as DaqpSettings, GenericSettings as GenericSettings, GenericSolver as GenericSolver
from .ldp import LdpSettings as LdpSettings
from .osqp import OsqpSettings as OsqpSettings
from .problem import QpProblem as QpProblem, QpSolution as QpSolution, SolverStatus as SolverStatus, Stacked as Stacked
from .proxqp import ProxqpSettings as ProxqpSettings
