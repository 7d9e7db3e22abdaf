"""What version 0.2 wrote, as its commit 37db319f writes it: cell files, recordings, studies, pickles, and its names.

    git worktree add ../earlier 37db319f && cd ../earlier && pip install .
    python tests/earlier/write_by_0_2.py tests/earlier/kept       # by that installation

``numbers.json.xz`` has what that version reads from its own files. Nothing here is written by a later version.
"""

from __future__ import annotations

import copy
import dataclasses
import importlib
import inspect
import json
import lzma
import pickle
import shutil
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numbers_read import numbers_of, sums_of
from pydantic import BaseModel

import coopqp
from coopqp import ForceController, ForceOptions, LinePath, QPController, QPOptions, load_cell_file, simulate
from coopqp.baselines import IndependentQPOptions, PseudoInverseOptions
from coopqp.control import RankWeights
from coopqp.drivers import FrankaOptions, Ros2BoardOptions, Ros2Options, SimOptions, UrOptions
from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.write import file_text
from coopqp.scenarios import dual_arm7, paper_lift, robot_file
from coopqp.simulation import Event, PhysicsOptions, PhysicsPlant, operating
from coopqp.studies import Local, load_study, sweep

# fmt: off
BAR = {"size_m": [0.6, 0.05, 0.05], "centre": {"xyz_m": [0.0, 0.0, 0.01]}, "mass_kg": 1.2}
TOOLS = {"left": {"xyz_m": [-0.3, 0.0, 0.0], "rpy_deg": [0, 90, 0]}, "right": {"xyz_m": [0.3, 0.0, 0.0],
         "rpy_rad": [0.0, np.pi / 2, np.pi]}}
START = [0.0, 23.0, 0.0, 122.0, 0.0, -55.0, 0.0]
LINE = {"kind": "line", "start": {"xyz_m": [0.0, 0.0, 0.3]}, "goal": {"xyz_m": [0.0, 0.1, 0.4], "rpy_deg": [0, 8, 0]},
        "duration_s": 2.0, "time_law": "quintic"}
SENSOR = {"reads": "left", "axes": [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], "force_gain": -1.0,
          "torque_gain": 1000.0, "bias_force_n": [1.0, 2.0, 3.0], "bias_torque_nm": [0.1, 0.2, 0.3],
          "delay_s": 0.01}
NONE = -1  # stands for no value: the key is false, or left out


def of_options(options: Any, **given: Any) -> dict[str, Any]:
    """The keys of a table of options, with the defaults of that version where nothing else is given."""
    table: dict[str, Any] = {}
    for field in dataclasses.fields(options):
        value = given.get(field.name, getattr(options, field.name))
        if dataclasses.is_dataclass(value):
            value = of_options(value)
        elif isinstance(value, tuple):
            value = list(value)
        if isinstance(value, (bool, int, float, str, list, dict)):
            table[field.name] = value
    return table


def arms() -> list[dict[str, Any]]:
    degrees = {"lower_deg": [-170.0] * 7, "upper_deg": [170.0] * 7, "velocity_deg_per_s": 60.0,
               "acceleration_deg_per_s2": 600.0}
    radians = {"lower_rad": [-2.9] * 7, "upper_rad": [2.9] * 7, "velocity_rad_per_s": 1.0,
               "acceleration_rad_per_s2": [10.0] * 7}
    matrix = [[-1.0, 0.0, 0.0, 0.85], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    left = {"name": "left", "robot": "arm7", "geometry": True, "base": {"xyz_m": [-0.85, 0.0, 0.0]}, "limits": degrees,
            "stiffness_nm_per_rad": 2e4, "sensor": SENSOR}
    right = {"name": "right", "urdf": "arm7.urdf", "tool_frame": "tool", "package_dirs": ["."], "geometry": True,
             "base": {"matrix": matrix}, "limits": radians, "stiffness_nm_per_rad": [2e4] * 7}
    return [left, right]


def bar(**more: Any) -> dict[str, Any]:
    start = {"positions_deg": {"left": START, "right": START}, "inverse_kinematics": True}
    return {"name": "bar", "arms": arms(), "grasp": {"kind": "tools", "tools": TOOLS}, "path": LINE, "start": start,
            "object": BAR, "dt_s": 0.01, **more}


def everything() -> Iterator[tuple[str, dict[str, Any]]]:
    """Cell files that use every key of that version but three: form, iterations and kernel of the controller."""
    qp = of_options(
        QPOptions(), solver="osqp", solver_settings={"max_iter": 5000}, grasp_gain=25.0,
        common_error={"kind": "driver", "leader": "left", "driver": "right"},
        supervision=of_options(QPOptions().supervision, slow_from=0.0005, apart_from=False),
        posture=of_options(QPOptions().posture, centring=0.1),
    )
    for key in ("form", "iterations", "kernel"):
        del qp[key]
    body = {"at": {"xyz_m": [0.0, 0.6, 0.2]}}
    collision = {
        "avoid": True, "margin_m": 0.012, "apart": 3, "object_apart": 2, "srdf": {"right": "arm7.srdf"},
        "obstacles": [
            {"name": "box", "shape": "box", "size_m": [0.1, 0.1, 0.1], **body},
            {"name": "post", "shape": "capsule", "radius_m": 0.03, "length_m": 0.2, "at": {"xyz_m": [0.0, 0.8, 0.2]}},
            {"name": "mesh", "shape": "mesh", "file": "tetra.obj", "scale": 0.1, "at": {"xyz_m": [0.0, -0.8, 0.0]}},
        ],
        "carried": [{"name": "object", "shape": "sphere", "radius_m": 0.05}],
        "on_links": [{"name": "glove", "shape": "sphere", "radius_m": 0.03, "link": "left/link_6"}],
        "without": ["right/link_2"], "margins": [{"between": ["glove", "post"], "margin_m": 0.02}],
        "ignored": [["glove", "object"]], "inside": [["box", "post"]], "decompose": [],
    }
    yield "bar", bar(
        controller={"kind": "qp", **qp}, collision=collision, plant={"kind": "kinematic"}, settle_s=0.1, patience_s=0.5,
        longest_s=9.0, verdict={"chain_mm": 0.2, "chain_deg": 0.2, "object_mm": 2.0, "object_deg": 1.0},
        drivers={"left": {"kind": "sim", **of_options(SimOptions(), lag=0.02)},
                 "right": {"kind": "ur", **of_options(UrOptions(), address="10.0.0.2")}},
        ros2=of_options(Ros2BoardOptions(), target_topic="/hand"),
    )

    way = {
        "poses": [{"xyz_m": [0.0, 0.0, 0.3]}, {"xyz_m": [0.0, 0.1, 0.4]}],
        "durations_s": [1.0],
        "time_law": "linear",
    }
    physics = of_options(PhysicsOptions(), stiffness=2e4, damping=200.0,
                         armature=[0.1] * 14, torque_limits=500.0, load_shares=[0.5, 0.5])
    told = {"folder": "out/engine", "recording": True, "report": True, "plots": True, "page": True, "csv": True,
            "bag": True}
    yield "engine", bar(
        path={"kind": "waypoints", **way}, plant={"kind": "physics", **physics}, output=told, steps=200, dt_s=NONE,
        controller={"kind": "qp", "common_error": {"kind": "per_axis", "weights": [[0.5] * 6, [0.5] * 6]}},
        disturbances={"wrench_noise_n": 1.0, "wrench_drop_share": 0.01, "seed": 7,
                      "sensors": {"right": SENSOR, "left": {"reads": "right"}}},
        drivers={"left": {"kind": "franka", **of_options(FrankaOptions(), address="10.0.0.3")},
                 "right": {"kind": "ros2", **of_options(
                     Ros2Options(), command_topic="/right/trajectory", wrench_topic="/right/wrench",
                     joint_prefix="right_", lag=False)}},
    )

    robots = [{"name": "lift", "robot": "lift2", "geometry": False, "base": {"xyz_m": [0.0, 0.0, 0.1]},
               "limits": {"*": {"acceleration_deg_per_s2": 300.0}, "lift": {"acceleration_rad_per_s2": 0.5}}}]
    up = {"kind": "line", "start": {"xyz_m": [0.55, 0.0, 0.2]}, "duration_s": 3.0, "time_law": "quintic",
          "displacement": {"translation_m": [0.0, 0.0, 0.5], "rotation_vector_deg": [0.0, 0.0, 5.0]}}
    yield "lift", {
        "name": "lift", "robots": robots, "dt_s": 0.01, "path": up,
        "arms": [{"name": s, "of": "lift", "tool_frame": f"{s}_tool"} for s in ("left", "right")],
        "grasp": {"kind": "tools", "tools": {"left": {"xyz_m": [0.0, 0.3, 0.0], "rpy_deg": [90, 0, 0]},
                                             "right": {"xyz_m": [0.0, -0.3, 0.0], "rpy_deg": [-90, 0, 0]}}},
        "controller": {"kind": "qp", "preview": False},
    }

    pin_ = {"arm": "left", "axis": "rx", "range_deg": [-60.0, 60.0]}
    latched = {"kind": "latched", "free": [pin_, {"arm": "right", "axis": "ry", "range_rad": [-1.0, 1.0]}]}
    held = {"kind": "hold", "pose": {"xyz_m": [0.0, 0.0, 0.3]}, "duration_s": 1.0}
    alone = of_options(IndependentQPOptions(), solver_settings={})
    soft = [{key: value for key, value in arm.items() if key != "stiffness_nm_per_rad"} for arm in arms()]
    yield "freed", bar(arms=soft, grasp=latched, path=held, controller={"kind": "independent", **alone})

    x, lifted = {"xyz_m": [0.3, 1.8, 0.0], "rpy_deg": [90, 0, 0]}, {"xyz_m": [0.9, 0.0, 0.1], "rpy_deg": [0, 0, -90]}
    poses = [x, x | {"xyz_m": [0.3, 1.8, 0.05]}]
    frame = {"xyz_m": [0.1, 0.2, 0.3], "rpy_rad": [0.0, 0.0, 0.4]}
    T = pin.SE3(pin.utils.rotate("z", -np.pi / 2), np.array([0.9, 0.0, 0.25]))
    line = LinePath(T, T * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05])), duration=1.0).geometry()
    timed = {"kind": "timed", "pieces": _pieces(line),
             "s_m": [0.0, 0.025, 0.05], "squares": [0.0, 0.01, 0.0], "planned_share": 0.98, "keeps_clear": False}
    turns = {"kind": "turns", "about_m": [0.0, 0.8, 0.1], "axis": [0.0, 0.0, 1.0]}
    three = [("master", 0.0, 0.0, 0), ("slave_1", 3.6, 0.5, 180), ("slave_2", 3.6, -0.5, 180)]
    yield "program", {
        "name": "program", "steps": 300, "attach": {"distance_mm": 3.0, "angle_deg": 0.5}, "signals_s": {"go": 3.0},
        "arms": [{"name": n, "robot": "rx90l", "geometry": False, "base": {"xyz_m": [a, b, 0.0], "rpy_deg": [0, 0, c]}}
                 for n, a, b, c in three],
        "grasp": {"kind": "triangle", "alpha_m": 0.6, "beta_m": 0.3},
        "phases": [
            {"name": "lift", "path": {"kind": "line", "start": lifted, "duration_s": 2.0, "time_law": "quintic",
             "displacement": {"translation_m": [0.0, 0.0, 0.15]}}},
            {"name": "waits", "duration_s": 0.5, "until": "go", "arms": {"slave_2": {"kind": "waits"}}},
            {"name": "works", "arms": {"slave_2": {"kind": "works", "poses": poses, "durations_s": [1.5],
                                                   "time_law": "quintic"}}},
            {"name": "back", "arms": {"slave_2": {"kind": "works", "poses": poses[::-1], "durations_s": [0.5]},
                                      "master": {"kind": "holds"}}},
            {"name": "over", "duration_s": 1.0, "arms": {"slave_2": {"kind": "travels", "to": x, "retreat_m": 0.01}}},
            {"name": "open", "duration_s": 2.0, "arms": {"slave_1": turns | {"angle_deg": 9.0, "holds": True}}},
            {"name": "close", "duration_s": 2.0, "arms": {"slave_1": turns | {"angle_rad": -0.157, "holds": True}}},
            {"name": "slide", "duration_s": 1.0, "arms": {
                "slave_2": {"kind": "slides", "axis": [0.0, 0.0, 1.0], "distance_m": -0.02}}},
            {"name": "rest", "arms": {"slave_2": {
                "kind": "follows", "frame": frame, "path": held, "holds": False, "holds_after": True}}},
            {"name": "timed", "path": timed},
        ],
    }


def _pieces(line: Any) -> Any:
    from coopqp import TimedPath
    from coopqp.paths.timed import SpeedProfile

    s = np.linspace(0.0, line.length, 3)
    return TimedPath(line, SpeedProfile(s, np.array([0.0, 0.01, 0.0]))).record()["pieces"]


def only_read() -> Iterator[tuple[str, dict[str, Any]]]:
    """Tables that are read here and not built: they need an extra, a long search, or files of somebody's robot."""
    low_high = {"low_m": [-1.0, -1.0, 0.0], "high_m": [1.0, 1.0, 1.0]}
    search = {"kind": "search", "goal": {"xyz_m": [0.0, 0.1, 0.4], "free": [{"axis": "rz", "range_deg": [-9.0, 9.0]}]},
              "start": {"xyz_m": [0.0, 0.0, 0.3]}, "region": low_high, "clearance_m": 0.001, "time_limit_s": 5.0,
              "nodes": 1000, "seed": 3, "speed_m_per_s": 0.2}
    turned = {"rpy_rad": [0.0, 0.1, 0.0]}
    mujoco = {"name": "left", "mjcf": "arm.xml", "tool_frame": "tool", "locked_joints_deg": {"finger": 3.0},
              "base": turned}
    own = {
        "name": "right",
        "urdf": "package://robots/arm.urdf",
        "tool_frame": "tool",
        "locked_joints_rad": {"thumb": 0.1},
    }
    free = [{"arm": "left", "axis": "z", "range_m": [-0.01, 0.01]}]
    numbers = of_options(PseudoInverseOptions(), reset_every=10)
    triangle = {"kind": "triangle", "alpha_m": 0.6, "beta_m": 0.3, "free": free}
    yield "search", bar(path=search, arms=[mujoco, own], controller={"kind": "pseudo_inverse", **numbers},
                        grasp=triangle,
                        start={"positions_rad": {"left": [0.0] * 7, "right": [0.0] * 7}, "inverse_kinematics": False})
    timed = {"kind": "timed", "pieces": [[0.0] * 19], "s_m": [0.0, 1.0], "squares": [0.0, 0.0], "planned_share": 0.9,
             "keeps_clear": True, "binding": [{"from_s": 0.0, "to_s": 1.0, "arm": "left", "joint": "joint_1",
                                               "limit": "velocity"}],
             "elbows": {"clocks_s": [0.0, 1.0], "positions_rad": [[0.0] * 14] * 2,
                        "speeds_rad_per_s": [[0.0] * 14] * 2}}
    yield "timed", bar(path=timed, grasp={"kind": "tools", "tools": TOOLS, "free": free}, start="auto")
    body = {"name": "lift", "urdf": "robot.urdf", "package_dirs": ["meshes"], "locked_joints_deg": {"head": 0.0},
            "locked_joints_rad": {"neck": 0.0}, "limits": {"lift": {"lower_rad": 0.0, "upper_rad": 0.5}}}
    rows = [[0.0] * 7, [0.1] * 7]
    follows = {"kind": "follows_joints", "positions_deg": rows, "durations_s": [1.0]}
    yield "joints", {"name": "joints", "robots": [body], "grasp": {"kind": "latched"}, "start": "auto",
        "arms": [{"name": s, "of": "lift", "tool_frame": f"{s}_tool"} for s in ("left", "right")],
        "phases": [
            {"name": "one", "path": {"kind": "line", **{k: v for k, v in LINE.items() if k != "kind"}}},
            {"name": "two", "path": {k: v for k, v in search.items()}},
            {"name": "three", "path": {"kind": "line", "duration_s": 1.0, "goal": {}},
             "arms": {"left": follows | {"speeds_rad_per_s": rows}}},
            {"name": "four", "path": {"kind": "line", "duration_s": 1.0, "goal": {}},
             "arms": {"left": {k: v for k, v in follows.items() if k != "positions_deg"} | {"positions_rad": rows}}},
            {"name": "five", "duration_s": 1.0, "arms": {"left": {
                "kind": "follows", "frame": {}, "path": timed, "holds": True, "holds_after": True}}},
        ]}


def without_none(table: Any) -> Any:
    if isinstance(table, dict):
        return {key: without_none(value) for key, value in table.items() if value is not NONE}
    return [without_none(value) for value in table] if isinstance(table, list) else table


def used(table: Any) -> Iterator[tuple[str, str]]:
    """Kind of table, and key, of every key that a file gives."""
    if isinstance(table, BaseModel):
        for key in table.model_fields_set:
            yield from ((kind.__name__, key) for kind in type(table).__mro__)
            yield from used(getattr(table, key))
    elif isinstance(table, (list, tuple)):
        for value in table:
            yield from used(value)
    elif isinstance(table, dict):
        for value in table.values():
            yield from used(value)


def known(kind: Any, seen: dict[str, set[str]]) -> None:
    """All kinds of tables, and their keys."""
    import typing

    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if kind.__name__ not in seen:
            seen[kind.__name__] = kind.model_fields.keys() & kind.__annotations__.keys()
            known(kind.__mro__[1], seen)
            for field in kind.model_fields.values():
                known(field.annotation, seen)
    else:
        for part in typing.get_args(kind):
            known(part, seen)


def cells(folder: Path) -> dict[str, Any]:
    (folder / "cells").mkdir()
    shutil.copyfile(robot_file("arm7"), folder / "cells" / "arm7.urdf")
    (folder / "cells" / "arm7.srdf").write_text(
        '<robot name="arm7"><disable_collisions link1="link_1" link2="link_3" reason="Never"/></robot>\n'
    )
    (folder / "cells" / "tetra.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    found: dict[str, Any] = {}
    keys: set[tuple[str, str]] = set()
    for name, tables in (*everything(), *only_read()):
        text = file_text([], without_none(copy.deepcopy(tables)))
        (folder / "cells" / f"{name}.toml").write_text(text, encoding="utf-8")
        settings = CellFile.model_validate(without_none(tables))
        keys |= set(used(settings))
        found[name] = {"settings": settings.model_dump(mode="json", exclude_unset=True)}
    for name, _ in everything():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found[name]["numbers"] = numbers_of(load_cell_file(folder / "cells" / f"{name}.toml"))
    all_keys: dict[str, set[str]] = {}
    known(CellFile, all_keys)
    left = {(kind, key) for kind, own in all_keys.items() for key in own} - keys
    assert left == {("QPTable", key) for key in ("form", "iterations", "kernel")}, left
    return found


def runs(folder: Path) -> dict[str, Any]:
    """Recordings: a simple run, one with forces, one along a program, one with an operator's calls."""
    lift = paper_lift(time_law="quintic")
    plain = simulate(QPController(lift.cell, lift.grasp, lift.path, dt=0.05), q_start=lift.q_start)
    plant = PhysicsPlant.of(lift)
    inner = QPController(lift.cell, lift.grasp, lift.path, dt=0.02)
    forces = ForceController(inner, ForceOptions(stiffness=1e5, relax_time=0.5, presses=False))
    felt = simulate(forces, plant=plant, q_start=lift.q_start, loads=True, duration=1.5)
    told = load_cell_file(folder / "cells" / "program.toml")
    program = simulate(
        told.controller(), q_start=told.scenario.q_start, duration=3.0, operate=operating([Event(40, "signal", "go")])
    )
    two = dual_arm7()
    calls = [Event(20, "pause"), Event(50, "jog", [[0.1, 0.0, 0.0, 0.0, 0.0, 0.0], "world", 0.3]),
             Event(80, "return_to_path"), Event(95, "forward")]
    led = simulate(QPController(two.cell, two.grasp, two.path, dt=0.02), q_start=two.q_start, duration=2.0,
                   operate=operating(calls))
    found = {}
    for name, run in (("lift", plain), ("forces", felt), ("program", program), ("operator", led)):
        run.save(folder / f"{name}.npz")
        found[name] = sums_of(run)
    return found


def studies(folder: Path) -> dict[str, Any]:
    file = folder / "study.toml"
    file.write_text(
        'name = "earlier"\nscenario = "paper_lift"\nseed = 3\ndraws = 2\ntimeout_s = 60.0\n'
        'set = { "steps" = 40 }\naxes = { "controller.path_gain" = [5.0, 20.0] }\n'
        'disturbances = { encoder_noise_rad = 1e-4 }\nfigures = ["chain_mm"]\n',
        encoding="utf-8",
    )
    study = load_study(file)
    made = sweep(study, Local(1), folder / "study")
    (folder / "study" / "runs.parquet").unlink(missing_ok=True)
    (folder / "study.pkl.xz").write_bytes(lzma.compress(pickle.dumps(study)))
    (folder / "sweep.pkl.xz").write_bytes(lzma.compress(pickle.dumps(made)))
    return {"digest": study.digest, "rows": [dict(row) for row in made.rows], "columns": list(made.columns)}


def pickles(folder: Path) -> None:
    """Objects that programs keep. A controller's memory is another one in each version."""
    lift = paper_lift()
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.05)
    controller.reset(lift.q_start)
    controller.step()
    inner = QPController(lift.cell, lift.grasp, lift.path, dt=0.02)
    forces = ForceController(inner, ForceOptions(stiffness=1e5, relax_time=0.5))
    options = QPOptions(path_gain=7.0, weights=RankWeights(grasp=2.0))
    for name, thing in (("controller", controller), ("forces", forces), ("options", options), ("scenario", lift)):
        (folder / f"{name}.pkl.xz").write_bytes(lzma.compress(pickle.dumps(thing)))


def names() -> dict[str, Any]:
    """Every public name of that version, and the fields of its options."""
    packages = ("baselines", "collision", "constraints", "control", "drivers", "files", "forces", "model", "paths",
                "planning", "programs", "scenarios", "simulation", "solvers", "studies", "visualization")
    found = {p: sorted(importlib.import_module(p).__all__) for p in ("coopqp", *(f"coopqp.{p}" for p in packages))}
    for module in ("coopqp.errors", "coopqp.native", "coopqp.output", "coopqp.spatial"):
        there = vars(importlib.import_module(module))
        found[module] = sorted(n for n, x in there.items() if n[0].isalpha() and getattr(x, "__module__", "") == module)
    options = {}
    for package, listed in found.items():
        for name in listed:
            thing = getattr(importlib.import_module(package), name)
            if inspect.isclass(thing) and name.endswith(("Options", "Settings", "Weights")):
                options[f"{package}.{name}"] = [field.name for field in dataclasses.fields(thing)]
    return {"names": found, "options": options}


def main() -> None:
    """Write the folder anew."""
    assert coopqp.__version__ == "0.2.0"
    folder = Path(sys.argv[1]).absolute()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    found = {"cells": cells(folder), "runs": runs(folder), "study": studies(folder), **names()}
    pickles(folder)
    (folder / "numbers.json.xz").write_bytes(lzma.compress(json.dumps(found).encode()))


if __name__ == "__main__":
    main()
