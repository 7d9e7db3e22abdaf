"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
from coopqp import simulate
from coopqp.scenarios import paper_lift
from coopqp.simulation import read_run

lift = paper_lift()

# %% coopqp.baselines.PseudoInverseController
from coopqp.baselines import PseudoInverseController

paper = PseudoInverseController(lift.cell, lift.grasp, lift.path, dt=lift.dt)
drift = read_run(lift.cell, simulate(paper, q_start=lift.q_start)).chain_mm.max()

# %% coopqp.baselines.PseudoInverseOptions
from coopqp.baselines import PseudoInverseOptions

exact = PseudoInverseOptions(increment="exact", integration="midpoint")
better = PseudoInverseController(lift.cell, lift.grasp, lift.path, dt=lift.dt, options=exact)
assert read_run(lift.cell, simulate(better, q_start=lift.q_start)).chain_mm.max() < drift

# %% coopqp.baselines.IndependentQPController, coopqp.baselines.IndependentQPOptions
from coopqp.baselines import IndependentQPController, IndependentQPOptions

alone = IndependentQPController(lift.cell, lift.grasp, lift.path, dt=lift.dt, options=IndependentQPOptions(gain=10.0))
run = simulate(alone, q_start=lift.q_start)
