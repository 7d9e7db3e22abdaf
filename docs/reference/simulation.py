"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np

from coopqp import CollisionScene, QPController, simulate
from coopqp.scenarios import dual_arm7, paper_lift

task = dual_arm7()


def controller():
    return QPController(task.cell, task.grasp, task.path, dt=0.01)


# %% coopqp.Recording
from coopqp import Recording

run = simulate(controller(), q_start=task.q_start)
run.save("run.npz")
again = Recording.load("run.npz")
assert again.finished
assert np.array_equal(again.q, run.q)

# %% coopqp.simulation.Event
from coopqp.simulation import Event, operating

events = [Event(50, "pause"), Event(150, "resume")]  # at the step of this number
operated = simulate(controller(), q_start=task.q_start, duration=6.0, operate=operating(events))

# %% coopqp.simulation.KinematicPlant, coopqp.simulation.Plant
from coopqp.simulation import KinematicPlant

run = simulate(controller(), KinematicPlant(task.cell), q_start=task.q_start)  # the default: commands are followed


class LatePlant:
    """A plant of one's own: takes the command of a step, returns what is measured then."""

    def reset(self, q):
        self.q = np.asarray(q)
        return self.q

    def apply(self, step):
        before, self.q = self.q, step.q_next
        return before


# %% coopqp.simulation.DisturbedPlant, coopqp.simulation.Disturbances
from coopqp.simulation import DisturbedPlant, Disturbances

noisy = Disturbances(encoder_noise=1e-5, latency=0.004)
run = simulate(controller(), DisturbedPlant(task.cell, task.grasp, noisy), q_start=task.q_start)

# %% coopqp.simulation.PhysicsPlant, coopqp.simulation.PhysicsOptions
from coopqp.simulation import PhysicsOptions, PhysicsPlant

lift = paper_lift(time_law="quintic")
plant = PhysicsPlant.of(lift, options=PhysicsOptions(timestep=0.001))
held = QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt)
run_in_engine = simulate(held, plant, q_start=lift.q_start, duration=0.2)
print(plant.wrenches()[:, 2].round(0))  # forces of the arms on the plate [N]

# %% coopqp.simulation.Readings
from coopqp.simulation import read_run

readings = read_run(task.cell, run)
print(f"arms apart by at most {readings.chain_mm.max():.3f} mm, σ_min {readings.sigma_min.min():.3f}")

# %% coopqp.simulation.Tolerances, coopqp.simulation.Finding
from coopqp.simulation import Tolerances, evaluate

findings = evaluate(task.cell, run, readings, tolerances=Tolerances(chain_mm=0.5))
for finding in findings:
    print(finding.holds, finding.question, finding.answer)

# %% coopqp.simulation.Closeness, coopqp.simulation.Closest
from coopqp.simulation import Closeness

closest = Closeness(CollisionScene.of(task)).closest(run.q_command, run.time)
print(closest.pair.first, closest.pair.second, f"{1e3 * closest.pair.distance:.0f} mm at {closest.time:.2f} s")

# %% coopqp.simulation.Monitor, coopqp.simulation.Monitored, coopqp.simulation.Verdict
from coopqp.simulation import Monitor, Monitored

watched = Monitored(controller(), Monitor(task.cell, task.grasp, tolerances={"chain_mm": 0.01}))
watched.reset(task.q_start)
for _ in range(10):
    watched.step()
assert watched.verdict().ok

# %% coopqp.simulation.Violation, coopqp.simulation.ViolationKind
from coopqp.simulation import check_run

for violation in check_run(run, task.cell).violations:
    print(violation.kind.value, violation.step, violation.arm, violation.joint)

# %% coopqp.simulation.WrenchBounds
from coopqp.simulation import WrenchBounds

careful = Monitor(lift.cell, lift.grasp, wrenches=WrenchBounds(internal_force=80.0))
