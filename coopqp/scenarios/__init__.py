"""Ready cells and tasks, one function each. :data:`SCENARIOS` maps their names to the functions."""

from __future__ import annotations

from collections.abc import Callable

from coopqp.errors import UnknownNameError
from coopqp.paths.scenario import EngineSettings, Scenario
from coopqp.scenarios.arms import ROBOTS, robot_arm, robot_data_path, robot_file, robot_table
from coopqp.scenarios.cells import dual_arm7, five_joint_pair, mixed_cell, panda_bar, ring, scara_pair, ur5_table
from coopqp.scenarios.loads import LOADED, base_off_lift, heavy_lift, hot_plate, palm_box, torque_lift
from coopqp.scenarios.obstacles import elbow_and_knob, elbows, forearms, plate_and_post, plate_and_table, random_posts
from coopqp.scenarios.one_robot import SHARED_JOINTS, torso_lift, two_on_a_rail
from coopqp.scenarios.paper import abb_lift, fast_lift, kuka_lift, mixed_lift, paper_lift, wide_grasp
from coopqp.scenarios.pins import bar_with_pins, five_joint_pins
from coopqp.scenarios.programs import PROGRAMS, conveyor, draw_on_plate, hand_over, pliers, positioner, regrasp_plate
from coopqp.scenarios.robots import ROBOT_NAMES, robot_path
from coopqp.scenarios.troubles import at_limit, at_singularity

__all__ = [
    "LOADED",
    "PROGRAMS",
    "ROBOTS",
    "ROBOT_NAMES",
    "SCENARIOS",
    "SHARED_JOINTS",
    "EngineSettings",
    "Scenario",
    "abb_lift",
    "at_limit",
    "at_singularity",
    "bar_with_pins",
    "base_off_lift",
    "conveyor",
    "draw_on_plate",
    "dual_arm7",
    "elbow_and_knob",
    "elbows",
    "fast_lift",
    "five_joint_pair",
    "five_joint_pins",
    "forearms",
    "hand_over",
    "heavy_lift",
    "hot_plate",
    "kuka_lift",
    "mixed_cell",
    "mixed_lift",
    "palm_box",
    "panda_bar",
    "paper_lift",
    "plate_and_post",
    "plate_and_table",
    "pliers",
    "positioner",
    "random_posts",
    "regrasp_plate",
    "ring",
    "robot_arm",
    "robot_data_path",
    "robot_file",
    "robot_path",
    "robot_table",
    "scara_pair",
    "scenario",
    "torque_lift",
    "torso_lift",
    "two_on_a_rail",
    "ur5_table",
    "wide_grasp",
]

#: The function of every scenario, by name; scenarios in :data:`LOADED` run in the physics engine,
#: those in :data:`PROGRAMS` are programs, and arms of those in :data:`SHARED_JOINTS` share joints. A call without
#: arguments uses the defaults. Some need the extra ``robots``.
SCENARIOS: dict[str, Callable[[], Scenario]] = {
    make.__name__: make  # the functions have other arguments, all with defaults
    for make in (
        paper_lift, wide_grasp, fast_lift, kuka_lift, abb_lift, mixed_lift, at_limit, at_singularity, dual_arm7,
        panda_bar, ur5_table, mixed_cell, ring, scara_pair, five_joint_pair, plate_and_post, plate_and_table,
        elbow_and_knob, elbows, forearms, random_posts, *LOADED.values(), *PROGRAMS.values(), five_joint_pins,
        bar_with_pins, *SHARED_JOINTS.values(),
    )
}  # fmt: skip


def scenario(name: str) -> Scenario:
    """Build the scenario of this name, with its defaults.

    Raises:
        UnknownNameError: no such scenario.
        MissingExtraError: the package of its robots is not installed.
    """
    if name not in SCENARIOS:
        raise UnknownNameError("scenario", name, SCENARIOS)
    return SCENARIOS[name]()
