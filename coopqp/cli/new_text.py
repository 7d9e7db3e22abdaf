"""The cell file of ``coopqp new``: round numbers, with comments that say what was guessed and found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coopqp.errors import printable
from coopqp.files.cellfile.write import relative, toml_key, toml_value
from coopqp.model.arm import Arm
from coopqp.model.cell import RobotCell, slides
from coopqp.model.tool_guess import ToolGuess
from coopqp.scenarios.arms import ROBOTS
from coopqp.studies.drafting import Draft, Motion, positions_of


@dataclass(frozen=True, kw_only=True)
class Choice:
    """An arm that was asked for.

    Attributes:
        name: its name in the cell.
        robot: the robot's name if it is one of coopqp's list; else empty.
        file: its URDF.
        guess: tool frame and fingers.
    """

    name: str
    robot: str
    file: Path
    guess: ToolGuess


def draft_text(
    name: str, choices: Sequence[Choice], arms: Sequence[Arm], motion: Motion, mass: float, drafted: Draft, into: Path
) -> str:
    """The cell file in TOML.

    Args:
        name: name of the cell.
        choices, arms: the arms that were asked for, as they were read.
        motion: what the object is and does.
        mass: its mass [kg].
        drafted: what was found.
        into: folder of the file.
    """
    *others, last = (choice.robot or choice.file.stem for choice in choices)
    robots = printable(f"{', '.join(others)} and {last}")
    lines = [
        f"# {robots} move an object together. Written by `coopqp new`; `coopqp schema` explains every key.",
        f"# After a change: coopqp check {name}.toml. To run it: coopqp run {name}.toml --plots",
        f"name = {toml_value(name)}",
    ]
    for choice, arm, own in zip(choices, arms, drafted.arms, strict=True):
        turned = f", rpy_deg = [0, 0, {own.base_yaw_deg:g}]" if own.base_yaw_deg else ""
        lines += [
            "",
            "[[arms]]",
            f"name = {toml_value(choice.name)}",
            *_model_lines(choice, arm, into),
            f"base = {{ xyz_m = {_list(own.base_xyz)}{turned} }} # found; where does yours stand?",
        ]
        if not (arm.limits.velocity <= np.array(arm.model.velocityLimit)).all():
            lines.append(
                f"limits = {_speeds(arm)} # --speed where the file tells none; accelerations may be added here"
            )
        elif not (choice.robot and ROBOTS[choice.robot].acceleration):
            lines.append(f"# limits = {_limits(arm)} # of the data sheet: `coopqp plan` needs them")
    lines += ["", "[grasp] # where the tools hold the object: they point down at its upper side", 'kind = "tools"']
    for choice, own in zip(choices, drafted.arms, strict=True):
        at, rpy = _list(own.tool_xyz), _list(own.tool_rpy_deg)
        lines.append(f"tools.{toml_key(choice.name)} = {{ xyz_m = {at}, rpy_deg = {rpy} }}")
    turn = _list((0.0, 0.0, motion.turn_deg))
    lines += [
        "",
        "[path] # a straight line, with a turn about the vertical",
        'kind = "line"',
        f"start = {{ xyz_m = {_list((0.0, 0.0, drafted.height))} }}",
        f"displacement = {{ translation_m = {_list(motion.translation)}, rotation_vector_deg = {turn} }}",
        f"duration_s = {motion.duration:g}",
        "",
        "[object] # its box, around the origin of its frame",
        f"size_m = {_list(motion.size)}",
        f"mass_kg = {mass:g}",
        "",
        "[start] # found; without this table it is searched again",
    ]
    for choice, arm, placed in zip(choices, arms, drafted.placed.arms, strict=True):
        x = positions_of(arm, placed.q)
        rounded = np.where(slides(RobotCell([arm])), np.round(x, 4), np.round(np.rad2deg(x), 1)) + 0.0
        lines.append(f"positions_deg.{toml_key(choice.name)} = {_list(rounded)}")
    lines += [
        "",
        "[collision] # links, arms and object keep 10 mm apart; [[collision.obstacles]] adds bodies of the room",
        "",
    ]
    return "\n".join(lines)


def _model_lines(choice: Choice, arm: Arm, into: Path) -> list[str]:
    """The lines that name the robot, its tool frame and its locked fingers."""
    guess = choice.guess
    others = printable(f", or: {', '.join(guess.others)}") if guess.others else ""
    frame = f"tool_frame = {toml_value(guess.tool_frame)} # guessed{others}"
    if choice.robot:
        listed = guess.tool_frame == ROBOTS[choice.robot].tool_frame
        return [f"robot = {toml_value(choice.robot)}", *(() if listed else (frame,))]
    file = choice.file.as_posix() if choice.file.is_absolute() else relative(choice.file, into)
    lines = [f"urdf = {toml_value(file)}", frame]
    if guess.locked:
        fingers = ", ".join(f"{toml_key(joint)} = {at:g}" for joint, at in guess.locked.items())
        lines.append(f"locked_joints_rad = {{ {fingers} }} # fingers; sliding ones in metres")
    if arm.visual is None and arm.collision is None:
        lines.append("geometry = false # its meshes cannot be read: nothing of this arm is looked at for distances")
    return lines


def _speeds(arm: Arm) -> str:
    """The speeds of all joints, as they are asked for where the file tells none."""
    sliding = np.array(slides(RobotCell([arm])))
    speeds = np.where(sliding, arm.limits.velocity, np.rad2deg(arm.limits.velocity))
    return f"{{ velocity_deg_per_s = {_list(np.round(speeds, 4))} }}"


def _limits(arm: Arm) -> str:
    """Acceleration limits as an example: one number, or one for each joint where some slide."""
    sliding = slides(RobotCell([arm]))
    example = _list([2.0 if slide else 300.0 for slide in sliding]) if any(sliding) else "300"
    return f"{{ acceleration_deg_per_s2 = {example} }}"


def _list(values: Sequence[float] | np.ndarray) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"
