"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np

from coopqp import QPOptions
from coopqp.solvers import make_solver

# %% coopqp.solvers.QpProblem
from coopqp.solvers import QpProblem

# The point nearest to (2, 0) with x0 = x1 and x in [0, 1]: minimise ½ xᵀH x + gᵀx.
problem = QpProblem(
    H=np.eye(2), g=np.array([-2.0, 0.0]),
    A=np.array([[1.0, -1.0]]), b=np.zeros(1),
    C=np.zeros((0, 2)), l=np.zeros(0), u=np.zeros(0),
    lb=np.zeros(2), ub=np.ones(2),
)  # fmt: skip

# %% coopqp.solvers.QpSolver, coopqp.solvers.QpSolution, coopqp.solvers.SolverStatus
solver = make_solver("daqp")
solution = solver.solve(problem)
assert solution.usable
print(solution.status, solution.iterations)
assert np.allclose(solution.x, [1.0, 1.0])

# %% coopqp.solvers.SolverSettings, coopqp.solvers.OsqpSettings
from coopqp.solvers import OsqpSettings

options = QPOptions(solver="osqp", solver_settings=OsqpSettings(max_iter=2000))

# %% coopqp.solvers.LdpSettings
from coopqp.solvers import LdpSettings

options = QPOptions(solver="ldp", solver_settings=LdpSettings(feasibility_tol=1e-7))

# %% coopqp.solvers.ProxqpSettings
from coopqp.solvers import ProxqpSettings

options = QPOptions(solver="proxqp", solver_settings=ProxqpSettings(eps_abs=1e-8))

# %% coopqp.solvers.GenericSettings
from coopqp.solvers import GenericSettings

settings = GenericSettings(options={"max_iter": 200})  # keyword arguments of the backend
general = make_solver("qpsolvers:osqp", settings)  # any backend of qpsolvers

# %% coopqp.solvers.DaqpSettings
from coopqp.solvers import DaqpSettings

options = QPOptions(solver="daqp", solver_settings=DaqpSettings(iter_limit=500))
