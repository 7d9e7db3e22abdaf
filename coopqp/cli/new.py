"""The subcommand ``coopqp new``: a first cell file for arms that nobody has placed yet."""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from coopqp.cli.check import EXIT_STATUS, glance_at
from coopqp.cli.terminal import add_command, print_written, reporter, say
from coopqp.errors import CoopqpError, ModelError, printable

if TYPE_CHECKING:
    from coopqp.cli.new_text import Choice
    from coopqp.model.arm import Arm
    from coopqp.studies.drafting import Motion

_T = TypeVar("_T")
#: Of the reach of the shortest arm: length of the object and what it moves by (y and z), unless they are given.
_LENGTH, _ASIDE, _LIFT = 0.6, 0.1, 0.2
#: Thickness of the object, its width for two arms [m], its mass [kg], its turn [deg], the duration of the path [s].
_THICK, _WIDE, _MASS, _TURN, _DURATION = 0.05, 0.1, 2.0, 10.0, 3.0


def _add_new(commands: Any) -> None:
    parser = add_command(
        commands,
        "new",
        _run_new,
        force="an earlier file",
        help="write a cell file for your arms: bases, tools and a start are found",
        description="Write a cell file for arms that nobody has placed yet. Tool frames and fingers are guessed from "
        "the URDFs; places of the bases, grasps and a start are searched, so that the arms follow the path with good "
        "margins and touch nothing. The file is then checked and drawn. Without --arm the command asks.",
        epilog="Exit status: as of `coopqp check`; 3, too, if no place is found for the bases.",
    )
    parser.add_argument("name", nargs="?", default="my_cell", metavar="NAME", help="name of the cell (my_cell)")
    parser.add_argument(
        "--arm",
        action="append",
        default=[],
        metavar="ROBOT",
        help="a URDF file, or the name of a robot (`coopqp schema --robots`, or NAME.urdf of an installed package); "
        "ROBOT:FRAME names the tool frame. Give it for each arm, two or more",
    )
    unknown = 'of joints for which a URDF tells none (velocity="0")'
    parser.add_argument("--speed", type=float, metavar="DEG_PER_S", help=f"largest speed {unknown}")
    parser.add_argument("--sliding-speed", type=float, metavar="M_PER_S", help="the same of joints that slide")
    parser.add_argument("--object", type=float, nargs=3, metavar=("LX", "LY", "LZ"), help="sides of its box [m]")
    parser.add_argument("--mass", type=float, metavar="KG", help=f"mass of the object ({_MASS:g} kg)")
    parser.add_argument("--move", type=float, nargs=3, metavar=("X", "Y", "Z"), help="how far the object goes [m]")
    parser.add_argument("--turn", type=float, metavar="DEG", help=f"how far it turns about the vertical ({_TURN:g}°)")
    parser.add_argument("--duration", type=float, metavar="S", help=f"duration of the path ({_DURATION:g} s)")
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="folder of NAME.toml and NAME.png (.)")


def _run_new(arguments: argparse.Namespace) -> int:
    from coopqp.cli.new_text import draft_text
    from coopqp.cli.runs import safe_name
    from coopqp.output import check_folder, check_unused, write_files
    from coopqp.studies.drafting import draft
    from coopqp.visualization.cell_overview import glance_figure
    from coopqp.visualization.style import figure_bytes

    asks = not arguments.arm
    if asks and not sys.stdin.isatty():
        raise CoopqpError("which arms? Give --arm twice or more: a URDF file, or a name of `coopqp schema --robots`.")
    robots = arguments.arm or _ask("arms (URDF files or names of robots, with spaces between)", None, _words)
    name = safe_name(_ask("name of the cell", arguments.name, str) if asks else arguments.name)
    file, picture = (arguments.out / f"{name}{suffix}" for suffix in (".toml", ".png"))
    check_unused((file, picture), force=arguments.force)
    check_folder(arguments.out)
    with reporter(quiet=arguments.quiet) as report:
        report.note("reading the arms")
        choices = _choices(robots)
        speeds = _speeds(arguments)
        arms = [_arm(choice, speeds, report.note) for choice in choices]
        _refuse_one_body(choices, arms)
    motion, mass = _motion(arguments, arms, asks=asks)
    with reporter(quiet=arguments.quiet) as report:
        report.note("looking for places of the bases")
        drafted = draft(arms, motion)
        text = draft_text(name, choices, arms, motion, mass, drafted, arguments.out)
        written = write_files({file: text.encode()})
        found, _ = glance_at(str(file), report)
        report.note("drawing the cell")
        written += write_files({picture: figure_bytes(glance_figure(found), dpi=110)})
    if not arguments.quiet:
        for choice in choices:
            print(printable(_guessed(choice)))
        for line in found.lines():
            print(printable(line))
        print_written(written, apart=True)
    return EXIT_STATUS[found.check.verdict.value]


def _ask(question: str, default: _T | None, read: Callable[[str], _T]) -> _T:
    """An answer of the user; the default for an empty line. Asked again until it can be read."""
    values = default if isinstance(default, tuple) else (default,)
    shown = " ".join(str(value).removesuffix(".0") for value in values)
    while True:
        try:
            answer = input(f"{question}{'' if default is None else f' [{shown}]'}: ").strip()
        except EOFError as error:
            raise CoopqpError("the questions were not answered. Give --arm and the other options.") from error
        if not answer and default is not None:
            return default
        try:
            if answer:
                return read(answer)
        except ValueError:
            pass
        say("not understood:", answer or "an empty line")


def _words(text: str) -> list[str]:
    return text.split()


def _numbers(text: str) -> tuple[float, ...]:
    """Three numbers, with spaces or commas between."""
    numbers = tuple(float(word) for word in text.replace(",", " ").split())
    if len(numbers) != 3:
        raise ValueError(text)
    return numbers


# -- the arms ------------------------------------------------------------------------------------------------------


def _choices(robots: Sequence[str]) -> list[Choice]:
    """The arms that were asked for, with names of their own."""
    from coopqp.cli.new_text import Choice
    from coopqp.model.tool_guess import guess_tool
    from coopqp.scenarios.arms import ROBOTS
    from coopqp.scenarios.found import find_robot

    if len(robots) < 2:
        raise CoopqpError("a cell has two or more arms: give --arm again, also for a second arm of the same robot.")
    stems, made = [], []
    for asked in robots:
        robot, frame = asked, None
        if not Path(asked).is_file() and ":" in asked:
            robot, _, frame = asked.rpartition(":")
        file = find_robot(robot)
        known = robot in ROBOTS and not Path(robot).is_file()
        made.append((robot if known else "", file, guess_tool(file, tool_frame=frame)))
        stems.append("".join(c if c.isalnum() else "_" for c in Path(robot).stem))
    return [
        Choice(name=stem if stems.count(stem) == 1 else f"{stem}_{stems[: k + 1].count(stem)}",
               robot=robot, file=file, guess=guess)
        for k, (stem, (robot, file, guess)) in enumerate(zip(stems, made, strict=True))
    ]  # fmt: skip


def _arm(choice: Choice, speeds: Mapping[bool, float], tell: Callable[[str], None]) -> Arm:
    """The arm with its fingers locked; without shapes where its meshes cannot be read."""
    from coopqp.model.arm import Arm
    from coopqp.scenarios.arms import robot_arm

    frame = choice.guess.tool_frame
    if choice.robot:
        return robot_arm(choice.robot, name=choice.name, tool_frame=frame)
    asked: dict[str, Any] = {"tool_frame": frame, "locked_joints": choice.guess.locked or None}
    asked["velocity_limits"] = math.inf  # until it is known which ones the file tells
    try:
        arm = Arm.from_urdf(choice.name, choice.file, **asked)
    except ModelError as error:  # of its meshes, if it can be read without them
        arm = Arm.from_urdf(choice.name, choice.file, geometry=False, **asked)
        tell(f"arm {choice.name} is read without its shapes, with which nothing is checked: {error}")
    return _limited(arm, speeds)


def _speeds(arguments: argparse.Namespace) -> dict[bool, float]:
    """The speeds that are given, of joints that turn [rad/s] and, under True, of those that slide [m/s]."""
    from coopqp.checks import as_scalar

    out = {}
    if arguments.speed is not None:
        out[False] = math.radians(as_scalar(arguments.speed, "--speed", high=1e6))
    if arguments.sliding_speed is not None:
        out[True] = as_scalar(arguments.sliding_speed, "--sliding-speed", high=1e3)
    return out


def _limited(arm: Arm, speeds: Mapping[bool, float]) -> Arm:
    """The arm with the largest speeds of its file, or those that are given where the file tells none."""
    import numpy as np

    from coopqp.model.cell import RobotCell, slides
    from coopqp.model.joint_limits import SMALLEST_LIMIT, UNLIMITED

    told = np.array(arm.model.velocityLimit)
    unknown = told < SMALLEST_LIMIT
    for j, slide in enumerate(slides(RobotCell([arm]))):
        if unknown[j] and slide not in speeds:
            option = "--sliding-speed M_PER_S" if slide else "--speed DEG_PER_S"
            raise CoopqpError(
                f"arm '{arm.name}': its file tells no speed of joint '{arm.model.names[j + 1]}' (velocity=\"0\"). "
                f"Give the one of the data sheet: {option}."
            )
        told[j] = speeds[slide] if unknown[j] else told[j] if told[j] < UNLIMITED else np.inf
    return arm.with_limits(velocity=told)


def _refuse_one_body(choices: Sequence[Choice], arms: Sequence[Arm]) -> None:
    """Raise for two arms of one robot: each would get a base, and so a body, of its own."""
    for (a, one), (b, other) in itertools.combinations(zip(choices, arms, strict=True), 2):
        first, second = (_joints_to_tool(arm) for arm in (one, other))
        if a.file == b.file and not (first <= second or second <= first):
            frame = a.guess.tool_frame
            raise CoopqpError(
                f"{frame} and {b.guess.tool_frame} are tools of two arms of one robot, {a.file.name}; `coopqp new` "
                "places robots of one arm. Write a cell file with a table [[robots]] for it, and for each tool a table "
                f'[[arms]] with of and tool_frame = "{frame}". `coopqp schema --example torso_lift` is such a file.'
            )


def _joints_to_tool(arm: Arm) -> set[str]:
    model = arm.model
    return {model.names[j] for j in model.supports[model.frames[model.getFrameId(arm.tool_frame)].parentJoint]}


def _guessed(choice: Choice) -> str:
    """One line on what was guessed."""
    guess = choice.guess
    fingers = f"; locked: {', '.join(guess.locked)}" if guess.locked else ""
    others = f" (also there: {', '.join(guess.others)})" if guess.others else ""
    return f"arm {choice.name}: {choice.robot or choice.file.name}, tool frame {guess.tool_frame}{others}{fingers}"


def _motion(arguments: argparse.Namespace, arms: Sequence[Arm], *, asks: bool) -> tuple[Motion, float]:
    """What the object is and does, and its mass [kg]: as given, answered, or in proportion to the shortest arm."""
    from coopqp.checks import as_scalar
    from coopqp.studies.drafting import Motion, reach

    shortest = min(reach(arm) for arm in arms)
    length = round(_LENGTH * shortest, 2)
    wide = min(_WIDE, length) if len(arms) == 2 else length
    defaults: dict[str, tuple[str, Any, Callable[[str], Any]]] = {
        "object": ("sides of the object's box in m, x y z", (length, wide, _THICK), _numbers),
        "mass": ("mass of the object in kg", _MASS, float),
        "move": (
            "how far it goes in m, x y z",
            (0.0, round(_ASIDE * shortest, 2), round(_LIFT * shortest, 2)),
            _numbers,
        ),
        "turn": ("how far it turns about the vertical in deg", _TURN, float),
        "duration": ("duration of the path in s", _DURATION, float),
    }
    answers = {}
    for key, (question, default, read) in defaults.items():
        value = getattr(arguments, key)
        answers[key] = value if value is not None else (_ask(question, default, read) if asks else default)
    size = tuple(as_scalar(side, "--object", high=100.0) for side in answers["object"])
    move = tuple(as_scalar(d, "--move", low=-100.0, high=100.0) for d in answers["move"])
    mass = as_scalar(answers["mass"], "--mass", high=1e5)
    turn = as_scalar(answers["turn"], "--turn", low=-179.0, high=179.0)
    duration = as_scalar(answers["duration"], "--duration", high=1e5)
    made = Motion(size=(size[0], size[1], size[2]), translation=(move[0], move[1], move[2]), turn_deg=turn,
                  duration=duration)  # fmt: skip
    return made, mass


COMMANDS = (_add_new,)
