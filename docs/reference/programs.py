"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np
import pinocchio as pin

from coopqp import LinePath, Phase
from coopqp.scenarios import paper_lift

task = paper_lift(time_law="quintic")
cell = task.cell.with_limits(acceleration=5.0)
X = task.grasp.T_object_tool[2]

# %% coopqp.Phase
lift = Phase("lift", path=task.path)  # all arms hold
rest = Phase("rest", duration=0.5)

# %% coopqp.Program, coopqp.programs.PhaseSpan
from coopqp import Program

program = Program(cell, task.grasp, [lift, rest])
span = program.spans[0]
assert (span.name, span.start, span.end) == ("lift", 0.0, 3.0)
assert span.holding == cell.arm_names

# %% coopqp.programs.Travels
from coopqp.programs import Travels

there = pin.SE3(X.rotation, X.translation + np.array([-0.1, 0.0, 0.0]))
regrasp = Phase("regrasp", duration=2.0, arms={"slave_2": Travels(to=there, retreat_m=0.04)}, until="closed")

# %% coopqp.programs.Waits
from coopqp.programs import Waits

aside = Phase("aside", duration=1.0, arms={"slave_2": Waits()})  # it has let go and stays beside its place

# %% coopqp.programs.Holds
from coopqp.programs import Holds

held = Phase("held", duration=1.0, arms={"slave_2": Holds()})  # as an arm that is not named

# %% coopqp.programs.Role
roles = (Travels(to=there), Waits(), Holds())
assert [role.holds for role in roles] == [False, False, True]

# %% coopqp.programs.Works
from coopqp.programs import Works

away = pin.SE3(X.rotation, X.translation + np.array([0.05, 0.0, 0.0]))
draw = Phase("draw", path=task.path, arms={"slave_2": Works(on=LinePath(X, away, duration=3.0))})

# %% coopqp.programs.Turns
from coopqp.programs import Turns

opening = {"slave_1": Turns(about=(0.0, 0.8, 0.0), angle=0.1), "slave_2": Turns(about=(0.0, 0.8, 0.0), angle=-0.1)}
opened = Phase("open", path=task.path, arms=opening)

# %% coopqp.programs.Slides
from coopqp.programs import Slides

drawer = Phase("drawer", duration=1.0, arms={"slave_2": Slides(axis=(1.0, 0.0, 0.0), distance_m=0.03)})

# %% coopqp.programs.Follows
from coopqp.programs import Follows

lid = LinePath(pin.SE3.Identity(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.02])), duration=1.0)
moving = Phase("lid", duration=1.0, arms={"slave_2": Follows(on=lid, frame=pin.SE3.Identity())})

# %% coopqp.programs.FollowsJoints
from coopqp.paths import JointPath
from coopqp.programs import FollowsJoints

joints = task.q_start[cell.q_slices[2]]
wave = JointPath([joints, joints + 0.1, joints], durations=1.0)
waving = Phase("wave", duration=2.0, arms={"slave_2": FollowsJoints(wave)})  # the others hold the object

# %% coopqp.programs.SearchedWay
from coopqp.planning import Search
from coopqp.programs import SearchedWay

assert issubclass(Search, SearchedWay)  # Phase("around", path=Search(goal, scene)): see there
