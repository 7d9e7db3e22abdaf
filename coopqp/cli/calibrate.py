"""The subcommand ``coopqp calibrate``: bases and grips from gripped runs."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.cli.terminal import add_command, print_written, reporter
from coopqp.errors import UnreachableError, printable
from coopqp.output import check_new, json_bytes, write_files

if TYPE_CHECKING:
    from coopqp.forces import DeterminingMotion
    from coopqp.forces.calibration import Calibration

_OK = 0


def add_calibrate(commands: Any) -> None:
    """Add the parser of ``coopqp calibrate``."""
    parser = add_command(
        commands,
        "calibrate",
        run_calibrate,
        force="what is there",
        help="calibrate bases and grips from gripped runs",
        description="Find the base placements and grips that close the chain at the measured configurations of runs in "
        "which all arms held one rigid object, and write the corrected cell file. No sensor is needed but the arms' "
        "encoders. The first arm is the reference.",
        epilog="Exit status: 0 with a corrected file; 2 for bad input, for runs in which the arms held nothing, and "
        "for a chain that no bases and grips close.",
    )
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING", help="recordings (.npz) of one cell")
    parser.add_argument("--out", type=Path, required=True, metavar="CELL", help="the corrected cell file (.toml)")
    parser.add_argument("--cell", type=Path, metavar="CELL", help="the cell file, for recordings that have none")
    parser.add_argument("--gripped", action="store_true", help="the arms held one object (recordings may not say it)")
    parser.add_argument(
        "--encoder-noise", type=float, metavar="RAD", help="amplitude of the joints' measuring noise (1e-4 rad or m)"
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help="also draw the loop residual before and after")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures as JSON")


def run_calibrate(arguments: argparse.Namespace) -> int:
    """Run ``coopqp calibrate``. Nothing is written unless there is a calibration."""
    from coopqp.files.cellfile import CellFileError, require_readers
    from coopqp.simulation.evaluation.calibration_runs import calibrate_runs
    from coopqp.simulation.recording.recording import Recording
    from coopqp.visualization.calibration import calibration_figure
    from coopqp.visualization.style import figure_bytes, require_matplotlib

    require_readers()
    if arguments.out.suffix != ".toml":
        raise CellFileError(f"--out {arguments.out}: a cell file is written in TOML. Give a name that ends in .toml.")
    if arguments.picture is not None:
        require_matplotlib()
    check_new(arguments.out, arguments.picture, arguments.json, force=arguments.force)
    from coopqp.files.cellfile.write import calibrated_text, settings_of

    options = {} if arguments.encoder_noise is None else {"encoder_noise": arguments.encoder_noise}
    with reporter(quiet=arguments.quiet) as report:
        runs = [Recording.load(file) for file in arguments.recordings]
        settings, folder = settings_of(runs[0].metadata, arguments.cell)
        report.note("closing the chain")
        found = calibrate_runs(runs, gripped=arguments.gripped or None, options=options)
        motion = None
        if found.undetermined:
            report.note("looking for the motion that determines the rest")
            motion = _motion(found, runs[0].q[0], options)
        sources = [str(arm.source) for arm in found.cell.arms]
        text = calibrated_text(settings, found, sources=sources, folder=folder, into=arguments.out.parent)
        contents = {arguments.out: text.encode()}
        if arguments.picture is not None:
            kind = arguments.picture.suffix.lstrip(".") or "png"
            contents[arguments.picture] = figure_bytes(calibration_figure(found), kind=kind)
        if arguments.json is not None:
            contents[arguments.json] = json_bytes(_record(found, motion))
        files = write_files(contents)
    if not arguments.quiet:
        print(*map(printable, found.explain().splitlines()), sep="\n")
        if motion is not None:
            print(_say(motion))
        print_written(files)
    return _OK


def _motion(found: Calibration, q: Any, options: dict[str, Any]) -> DeterminingMotion | None:
    """The motion that would determine more, from the start of the run; None if the arms can follow no tilt there."""
    from coopqp.forces import determining_motion
    from coopqp.model.inverse_kinematics import inverse_kinematics
    from coopqp.model.state import CellState

    try:
        start = found.grasp.carried(CellState(found.cell, q))[0]
        held = inverse_kinematics(found.cell, found.grasp, start, q)
        return determining_motion(found.cell, found.grasp, held, options=options)
    except UnreachableError:
        return None


def _say(motion: DeterminingMotion) -> str:
    tilts = ", ".join(
        f"{math.degrees(angle):.3g}° about {axis}" for angle, axis in zip(motion.tilts, "xyz", strict=True) if angle
    )
    left = len(motion.undetermined)
    what = "determines all of it" if not left else f"leaves {left} direction{'s' * (left > 1)} undetermined"
    return f"tilts of the object from the start, {tilts}, {what} (path {motion.check.verdict.value})"


def _record(found: Calibration, motion: DeterminingMotion | None) -> dict[str, Any]:
    return {
        "samples": len(found.samples),
        "closure_mm": {"before": 1e3 * found.before[:, 0].max(), "after": 1e3 * found.after[:, 0].max()},
        "closure_rad": {"before": found.before[:, 1].max(), "after": found.after[:, 1].max()},
        "arms": [
            {
                "arm": arm.arm,
                "base": arm.base.tolist(),
                "base_deviation": arm.base_deviation.tolist(),
                "grip": arm.grip.tolist(),
                "grip_deviation": arm.grip_deviation.tolist(),
                "significant": arm.significant,
            }
            for arm in found.corrections
        ],
        "undetermined": list(found.undetermined),
        "slip": None if found.slip is None else {"sample": found.slip[0], "shift_m": found.slip[1]},
        "motion": None
        if motion is None
        else {
            "tilts_rad": list(motion.tilts),
            "verdict": motion.check.verdict.value,
            "undetermined": list(motion.undetermined),
        },
    }


COMMANDS = (add_calibrate,)
