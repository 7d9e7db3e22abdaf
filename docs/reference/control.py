"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before

from coopqp import QPController
from coopqp.scenarios import dual_arm7

task = dual_arm7()

# %% coopqp.QPController, coopqp.control.Controller
controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
controller.reset(task.q_start)
for _ in range(200):
    step = controller.step()  # with a robot: controller.step(q_measured)

# %% coopqp.ControlStep
q_next, velocity = step.q_next, step.velocity  # what is sent
print(step.status.value, f"rate {step.rate:.2f}", step.explain())

# %% coopqp.Status
from coopqp import Status

assert step.status is Status.TRACKING

# %% coopqp.Cause
from coopqp import Cause

controller.set_override(0.5)
while controller.step().cause is not Cause.OPERATOR:
    pass  # the path speed goes down within the joints' accelerations

# %% coopqp.control.OperatorCalls
controller.pause()
while controller.step().rate > 0.0:
    pass
controller.reverse()  # back on the path, as far as it has come
controller.resume()

# %% coopqp.control.GivenUp, coopqp.control.SolverReport
step = controller.step()
assert step.given_up.chain == 0.0  # the arms hold the object exactly where it should be
print(step.solver.name, step.solver.iterations, f"{1e6 * step.solver.time_s:.0f} µs")

# %% coopqp.BindingLimit, coopqp.LimitKind
from coopqp import LimitKind

hasty = QPController(task.cell.with_limits(velocity=0.2), task.grasp, task.path, dt=task.dt)
hasty.reset(task.q_start)
while not (step := hasty.step()).binding:
    pass
assert step.binding[0].kind in (LimitKind.VELOCITY, LimitKind.ACCELERATION)
print(step.binding[0].arm, step.binding[0].joint)

# %% coopqp.QPOptions
from coopqp import QPOptions

gentle = QPOptions(path_gain=5.0, grasp_gain=5.0, correction_speed=0.02)
controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=gentle)

# %% coopqp.control.RankWeights
from coopqp.control import RankWeights

options = QPOptions(weights=RankWeights(posture=1e-5))

# %% coopqp.SupervisionOptions
from coopqp import SupervisionOptions

soft = QPOptions(supervision=SupervisionOptions(stiffness=1e5))  # N/m that the arms' grips give way with

# %% coopqp.PreviewOptions
from coopqp import PreviewOptions

careful = QPOptions(preview=PreviewOptions(margin=0.8))  # 80 % of each limit ahead

# %% coopqp.control.Coupling
from coopqp.control import couple

one, other = (QPController(task.cell, task.grasp, task.path, dt=task.dt) for _ in range(2))  # two groups of arms
for group in (one, other):
    group.reset(task.q_start)
both = couple(one, other)
steps = both.step()
assert both.lag == 0.0
