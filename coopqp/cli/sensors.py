"""The subcommand ``coopqp sensors``: wrist sensors identified by presses."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.cli.drive import ask_for_name, close_drivers, interrupts
from coopqp.cli.terminal import add_command, print_table, print_written, reporter
from coopqp.errors import InvalidInputError, printable
from coopqp.output import check_new, json_bytes, write_files

if TYPE_CHECKING:
    from coopqp.files.cellfile.build import CellRun
    from coopqp.files.cellfile.schema import CellFile
    from coopqp.forces.wrist_sensor import WristSensor
    from coopqp.simulation.commissioning import Commissioning

_OK, _WRONG = 0, 4


def add_sensors(commands: Any) -> None:
    """Add the parser of ``coopqp sensors``."""
    parser = add_command(
        commands,
        "sensors",
        run_sensors,
        force="what is there",
        help="identify the wrist sensors by presses in the engine",
        description="Let the arms press each other a little while they hold the object at rest, in the engine, and "
        "find for each wrist sensor the arm, axes, sign, gain, bias and delay.",
        epilog="Exit status: 0 if all sensors are right; 4 if one is wrong or undecided; 2 for bad input; 130 after an "
        "interrupt. With --out the sensors go into a new cell file; a sensor that is dead or undecided cannot be "
        "corrected, and nothing is written.",
    )
    parser.add_argument("cell", type=Path, metavar="CELL", help="cell file (.toml or .yaml)")
    parser.add_argument(
        "--driver",
        choices=("file", "engine"),
        help="press by drivers, as coopqp drive: the file's, or robots in the engine in real time; needs --enable",
    )
    parser.add_argument(
        "--enable", nargs="?", const="", metavar="NAME", help="move the robots; NAME is the cell's, or is asked for"
    )
    parser.add_argument("--out", type=Path, metavar="CELL2", help="the cell file with the sensors (.toml)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures as JSON")


def run_sensors(arguments: argparse.Namespace) -> int:
    """Run ``coopqp sensors``."""
    from coopqp.files.cellfile import CellFileError, load_cell_file
    from coopqp.files.cellfile.paths import folder_of
    from coopqp.simulation.commissioning import commission_sensors

    if arguments.out is not None and arguments.out.suffix != ".toml":
        raise CellFileError(f"--out {arguments.out}: a cell file is written in TOML. Give a name that ends in .toml.")
    check_new(arguments.out, arguments.json, force=arguments.force)
    if (arguments.driver is None) != (arguments.enable is None):
        raise InvalidInputError("--driver and --enable go together", "sensors", "Give both, or neither.")
    run = load_cell_file(arguments.cell)
    if arguments.enable is not None:
        ask_for_name(run.scenario.name, arguments.enable)
    with reporter(quiet=arguments.quiet) as report:
        report.note("pressing the arms against each other")
        if arguments.driver is None:
            found = commission_sensors(run.scenario, run.physics_plant(), known=run.sensors, stiffness=run.stiffness)
        else:
            found = _by_drivers(run, None if arguments.driver == "file" else arguments.driver)
        contents = {}
        if arguments.out is not None and found.sensors is not None:
            text = _text(run.settings, found.sensors, folder_of(arguments.cell), arguments.out.parent)
            contents[arguments.out] = text.encode()
        if arguments.json is not None:
            contents[arguments.json] = json_bytes(_record(found))
        files = write_files(contents)
    if not arguments.quiet:
        _say(found, wanted=arguments.out is not None)
        print_written(files)
    return _OK if found.judgement is not None and found.judgement.fine else _WRONG


def _by_drivers(run: CellRun, kind: str | None) -> Commissioning:
    """Press by the drivers of the cell; Ctrl-C brakes all arms together."""
    from coopqp.drivers.commissioning import commission_sensors_by_drivers

    drivers = run.drivers(kind)
    try:
        return commission_sensors_by_drivers(
            run.scenario, drivers, known=run.sensors, stiffness=run.stiffness, options={"ramp_time": 2.0},
            begun=interrupts,
        )  # fmt: skip
    finally:
        close_drivers(drivers)


def _text(settings: CellFile, sensors: dict[str, WristSensor], folder: Path, into: Path) -> str:
    """The cell file with the sensors."""
    from coopqp.files.cellfile.sensors import sensor_table
    from coopqp.files.cellfile.write import file_text, move_files

    tables = settings.model_dump(exclude_none=True, exclude_unset=True)
    move_files(tables["arms"], settings.arms, folder, into)
    for table in tables["arms"]:
        table["sensor"] = sensor_table(sensors[table["name"]])
    return file_text(["Wrist sensors as coopqp sensors found them, in the tables [arms.sensor]."], tables)


def _say(found: Commissioning, *, wanted: bool) -> None:
    if found.judgement is None:
        print(f"undecided: {printable(found.reason)}")
        return
    lines: list[list[str]] = [
        ["arm", "reads", "turned [deg]", "force gain", "torque gain", "bias [N]", "delay [ms]", "found"]
    ]
    rows = [_row(finding) for finding in found.judgement.findings]
    lines += [
        [
            row["arm"], row["reads"], f"{row['turned_deg']:.0f}", f"{row['force_gain']:.3g}",
            f"{row['torque_gain']:.3g}", f"{row['bias_force']:.1f}", f"{1e3 * row['delay_s']:.0f}",
            "; ".join(row["problems"]) or "right",
        ]
        for row in rows
    ]  # fmt: skip
    print_table([[printable(cell) for cell in line] for line in lines], numeric=[False, False, *[True] * 5, False])
    print(f"the presses added up to {found.added:.0f} N at a grasp")
    if wanted and found.sensors is None:
        print("nothing is written: a sensor is dead or undecided, and cannot be corrected")


def _row(finding: Any) -> dict[str, Any]:
    import numpy as np
    import pinocchio as pin

    return {
        "arm": finding.arm,
        "reads": finding.sits_at,
        "turned_deg": float(np.rad2deg(np.linalg.norm(pin.log3(finding.rotation)))),
        "force_gain": finding.force_gain,
        "torque_gain": finding.torque_gain,
        "bias": finding.bias.tolist(),
        "bias_force": float(np.linalg.norm(finding.bias[:3])),
        "drift": finding.drift.tolist(),
        "delay_s": finding.delay,
        "lost": finding.lost,
        "problems": list(finding.problems),
        "undecided": finding.undecided,
    }


def _record(found: Commissioning) -> dict[str, Any]:
    judgement = found.judgement
    return {
        "fine": judgement is not None and judgement.fine,
        "reason": found.reason,
        "added": found.added,
        "stiffer": None if judgement is None else judgement.stiffer,
        "sensors": [] if judgement is None else [_row(finding) for finding in judgement.findings],
    }


COMMANDS = (add_sensors,)
