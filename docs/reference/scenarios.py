"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% coopqp.scenarios.Scenario
from coopqp.scenarios import scenario

task = scenario("dual_arm7")
print(task.name, task.cell.arm_names, f"{task.path.duration:g} s, steps of {task.dt:g} s")

# %% coopqp.scenarios.EngineSettings
hot = scenario("hot_plate")
assert hot.engine is not None  # what a run in the physics engine takes
print(hot.engine.disturbances)

# %% coopqp.scenarios.arms.RobotEntry
from coopqp.scenarios import ROBOTS

entry = ROBOTS["rx90l"]
print(entry.joints, entry.tool_frame, entry.licence)
