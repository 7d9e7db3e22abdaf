"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np

from coopqp import QPController, simulate
from coopqp.planning import Payload
from coopqp.scenarios import paper_lift

lift = paper_lift(time_law="quintic")
payload = Payload(mass=20.0, centre=lift.T_object_body.translation)

# %% coopqp.forces.LoadShare, coopqp.forces.SharedLoad
from coopqp.forces import LoadShare

load = LoadShare(lift.cell, lift.grasp, payload, internal_force=50.0)
shared = load.share(lift.q_start)
assert shared.feasible
print(shared.explain(), shared.wrenches[:, 2].round(1))  # what each arm carries [N]

# %% coopqp.forces.Grip
from coopqp.forces import Grip

palms = [Grip(kind="palm", friction=0.6, radius=0.06)] * 3
held = LoadShare(lift.cell, lift.grasp, payload, internal_force=300.0, grips=palms).share(lift.q_start)

# %% coopqp.forces.LoadBound
from coopqp.forces import LoadBound

agile = lift.cell.with_limits(acceleration=20.0)
bound = LoadBound(LoadShare(agile, lift.grasp, payload, internal_force=50.0))
controller = QPController(agile, lift.grasp, lift.path, dt=0.01, constraints=[bound])

# %% coopqp.forces.LoadUse
from coopqp.forces import load_use

run = simulate(QPController(lift.cell, lift.grasp, lift.path, dt=0.05), q_start=lift.q_start)
use = load_use(load, run.time, run.q_command)
print(use.feasible, use.figures())

# %% coopqp.ForceController, coopqp.ForceOptions
from coopqp import ForceController, ForceOptions

stiff = QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt)
soft = ForceController(stiff, ForceOptions(stiffness=1e4, payload=payload))  # N/m of the grips
soft.reset(lift.q_start)
step = soft.step(lift.q_start, wrenches=np.zeros((3, 6)))  # what the wrist sensors read

# %% coopqp.forces.WristSensor
from coopqp.forces import WristSensor

turned = WristSensor(rotation=np.diag([-1.0, -1.0, 1.0]), bias=[1.0, 0.0, 2.0, 0.0, 0.0, 0.0])

# %% coopqp.forces.SensorJudgement, coopqp.forces.SensorFinding
from coopqp.simulation import PhysicsPlant
from coopqp.simulation.commissioning import commission_sensors

sensing = PhysicsPlant.of(lift)
answer = commission_sensors(lift, sensing)  # the arms press against each other at the start
assert answer.judgement.fine
print(answer.judgement.findings[0].explain())

# %% coopqp.forces.CalibrationOptions
from coopqp.forces import CalibrationOptions

options = CalibrationOptions(encoder_noise=1e-4, base_position=0.002)

# %% coopqp.forces.Calibration, coopqp.forces.ArmCorrection
from coopqp.simulation import calibrate_runs

plant = PhysicsPlant.of(lift)  # in the engine the arms hold the plate, which the calibration needs
gripped = simulate(QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt), plant, q_start=lift.q_start)
found = calibrate_runs([gripped], cell=lift.cell, options=options)
print(found.explain())
assert not any(arm.significant for arm in found.corrections)  # nothing was off

# %% coopqp.forces.DeterminingMotion
from coopqp.forces import determining_motion

motion = determining_motion(lift.cell, lift.grasp, lift.q_start)
print(np.rad2deg(motion.tilts).round(1), motion.check.verdict.value)

# %% coopqp.forces.StressModel, coopqp.forces.InternalStress
from coopqp.forces import StressModel

model = StressModel(lift.cell, lift.grasp, stiffness=1e4)
stress = model.estimate(lift.q_start)  # from measured configurations alone
print(stress.forces.round(1))
