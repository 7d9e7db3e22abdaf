"""Runs by name, from a recording, a cell file or a scenario; and the files made from a run."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.collision.clearance import Clearance
from coopqp.collision.scene import CollisionScene
from coopqp.control.qp import QPController
from coopqp.errors import InvalidInputError, OutputError, UnknownNameError
from coopqp.model.posture import PostureOptions
from coopqp.output import check_below, check_folder, check_unused, folder_of, numbered, write_files
from coopqp.paths.scenario import Scenario
from coopqp.planning.self_motion import led_path
from coopqp.simulation.engine import run_in_engine
from coopqp.simulation.evaluation.closeness import default_scene, with_clearance
from coopqp.simulation.events import Operate, begin_as
from coopqp.simulation.plants.kinematic import KinematicPlant, Plant
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import describe_object, read_object
from coopqp.simulation.simulate import ProgressCallback, simulate
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.files.cellfile.build import CellRun

#: Products of :func:`write_products` and their file names.
PRODUCTS = {
    "recording": ("recording.npz",),
    "report": ("report.html",),
    "plots": ("timeline.png", "joints.png", "motion.png", "loads.png"),
    "page": ("view.html",),
    "csv": ("run.csv",),
    "bag": ("bag",),
}


#: Functions that raise MissingExtraError for products that need an extra: module and name.
_NEEDS = {
    "report": ("coopqp.visualization.style", "require_matplotlib"),
    "plots": ("coopqp.visualization.style", "require_matplotlib"),
    "page": ("coopqp.visualization.viewer", "require_viser"),
    "bag": ("coopqp.files.export", "require_rosbags"),
}


def obtain_run(
    name: str,
    *,
    progress: ProgressCallback | None = None,
    meshes: bool = False,
    operate: Operate | None = None,
    begun: dict[str, Any] | None = None,
    settle: float = 0.0,
    longest: float | None = None,
) -> Recording:
    """Load a recording (``.npz``), run a cell file (``.toml``, ``.yaml``), or run a scenario with the QP.

    Args:
        name: a file, or one of :data:`coopqp.scenarios.SCENARIOS`.
        progress: as in :func:`coopqp.simulate`.
        meshes: as in :meth:`Recording.load`.
        begun: override and pause at the start, as of :func:`coopqp.simulation.events.begin_as`.
        operate, settle, longest: of a run, as in :func:`coopqp.simulate`; a cell file's own ones unless they are more.

    Raises:
        UnknownNameError: the name is neither a file nor a scenario.
        RecordingError, CellFileError, CoopqpError: the recording, the cell file or the run has an error.
    """
    from coopqp.files.cellfile import load_cell_file
    from coopqp.files.cellfile.error import TOML_SUFFIX, YAML_SUFFIXES
    from coopqp.scenarios import SCENARIOS

    file = Path(name)
    if file.suffix in (TOML_SUFFIX, *YAML_SUFFIXES):
        task = load_cell_file(file)
        task = replace(task, settle=max(task.settle, settle), longest=task.longest if longest is None else longest)
        return task.run(progress=progress, operate=operate, begun=begun)
    if file.suffix == ".npz" or (file.exists() and name not in SCENARIOS):
        return Recording.load(file, meshes=meshes)
    if name not in SCENARIOS:
        raise UnknownNameError("recording (.npz), cell file (.toml, .yaml) or scenario", name, SCENARIOS)
    if SCENARIOS[name]().engine is not None:
        if operate is not None:
            raise InvalidInputError(f"{name} runs in an engine by itself", "operator", "Give a cell file of it.")
        scenario = SCENARIOS[name]()
        run = run_in_engine(scenario, progress=progress, metadata=_metadata(scenario))
        return with_clearance(run, default_scene(scenario), avoided=False)
    live = _scenario_task(name)
    controller = live.controller()
    begin_as(controller, begun)
    run = simulate(
        controller, q_start=live.q_start, duration=longest, settle=settle, progress=progress, operate=operate,
        metadata=dict(live.metadata),
    )  # fmt: skip
    return live.finished(run)


def _metadata(scenario: Scenario) -> dict[str, Any]:
    box = describe_object(scenario.object_size, scenario.T_object_body)
    return {"scenario": scenario.name, "method": "qp", "object": box}


@dataclass(frozen=True, eq=False)
class Task:
    """A cell to be run, with all that a run needs.

    Attributes:
        name: of the task.
        controller, plant: make a new one.
        q_start: where it begins (nq,).
        metadata: of its recordings.
        scene: bodies that keep distances; may be None.
        avoids: the controller keeps them.
    """

    name: str
    controller: Callable[[], QPController]
    plant: Callable[[], Plant]
    q_start: Array
    metadata: Mapping[str, Any]
    scene: CollisionScene | None
    avoids: bool

    def finished(self, run: Recording) -> Recording:
        """A run with how close bodies came."""
        return with_clearance(run, self.scene, avoided=self.avoids)

    def at_start(self) -> Recording:
        """The cell at its start, as a run of one step."""
        controller = self.controller()
        run = simulate(controller, q_start=self.q_start, duration=controller.dt, metadata=dict(self.metadata))
        shown = self.finished(run)
        return replace(shown, metadata={k: v for k, v in shown.metadata.items() if k != "clearance"})


def obtain_task(name: str) -> Task:
    """The task of a cell file, or of a scenario with the QP.

    Raises:
        UnknownNameError: the name is neither a file nor a scenario.
        InvalidInputError: another controller than the QP, or a scenario that runs in an engine by itself.
        CellFileError, CoopqpError: the cell file has an error.
    """
    from coopqp.files.cellfile import load_cell_file, require_readers
    from coopqp.files.cellfile.error import TOML_SUFFIX, YAML_SUFFIXES
    from coopqp.scenarios import SCENARIOS

    file = Path(name)
    if file.suffix not in (TOML_SUFFIX, *YAML_SUFFIXES):
        if name not in SCENARIOS:
            raise UnknownNameError("cell file (.toml, .yaml) or scenario", name, SCENARIOS)
        return _scenario_task(name)
    require_readers()
    return task_of(load_cell_file(file))


def task_of(run: CellRun) -> Task:
    """The task of a cell file that is read; errors as of :func:`obtain_task`."""
    if run.controller_kind != "qp":
        raise InvalidInputError(f"the controller is '{run.controller_kind}'", str(run.file), 'Give kind = "qp".')
    led = run.led()
    make: Any = led.controller
    s = run.scenario
    return Task(s.name, make, run.plant, s.q_start, run.metadata(), run.scene, run.avoids)


def _scenario_task(name: str) -> Task:
    from coopqp.scenarios import SCENARIOS

    s = SCENARIOS[name]()
    if s.engine is not None:
        raise InvalidInputError(f"{name} runs in an engine by itself", "operator", "Give a cell file of it.")
    scene = CollisionScene.of(s) if s.obstacles else default_scene(s)
    avoids = bool(s.obstacles)
    led = led_path(
        s.cell, s.grasp, s.path, q_start=s.q_start, posture=PostureOptions(), scene=scene if avoids else None
    )

    def make() -> QPController:
        constraints = [Clearance(scene)] if avoids and scene is not None else []
        return QPController(s.cell, s.grasp, led, dt=s.dt, constraints=constraints)

    return Task(s.name, make, lambda: KinematicPlant(s.cell), s.q_start, _metadata(s), scene, avoids)


def output_folder(name: str, asked: str | None, products: Iterable[str], *, out: Path | None, force: bool) -> Path:
    """The folder of a run. Nothing in it is overwritten, unless ``force``.

    Args:
        name: name of the run.
        asked: folder that the cell file asks for, below the working directory.
        products: names of :data:`PRODUCTS`.
        out: folder of the option ``--out``: any folder.
        force: overwrite what is there.

    Raises:
        UnknownNameError: no such product.
        MissingExtraError: a product needs an extra that is not installed.
        OutputError: the folder cannot be written, ``out`` already has one of the products, or without ``out`` a link
            leads out of the working directory.
    """
    wanted = list(products)
    for product in wanted:
        if product not in PRODUCTS:
            raise UnknownNameError("product", product, PRODUCTS)
        if product in _NEEDS:
            module, guard = _NEEDS[product]
            getattr(import_module(module), guard)()
    files = [file for product in wanted for file in PRODUCTS[product]]
    folder = free_folder(name, asked, files, out=out, force=force)
    if wanted:
        check_folder(folder)
    return folder


def free_folder(name: str, asked: str | None, files: Sequence[str], *, out: Path | None, force: bool) -> Path:
    """The folder for some files of a run; arguments and errors as in :func:`output_folder`."""
    folder = out or Path(asked or Path("out") / safe_name(name))
    if out is not None:
        check_unused((folder / file for file in files), force=force)
        return folder
    if not force:
        folder = numbered(folder, lambda place: any((place / file).exists() for file in files))
    check_below(folder)
    return folder


def write_products(
    recording: Recording,
    folder: Path,
    products: Iterable[str],
    *,
    tell: Callable[[str], None] | None = None,
    force: bool = False,
) -> list[Path]:
    """Write products into a folder. Returns the files in the order of :data:`PRODUCTS`.

    Args:
        recording: the run.
        folder: output folder; created if missing.
        products: names of :data:`PRODUCTS`.
        tell: called with a text for each stage.
        force: overwrite what is there; by default it is an error.

    Raises:
        UnknownNameError, OutputError: as in :func:`output_folder`.
        MissingExtraError: a product needs an extra that is not installed.
    """
    from coopqp.files.export import write_bag, write_csv
    from coopqp.visualization.report import write_report
    from coopqp.visualization.viewer import export_html

    wanted = set(products)
    output_folder("", None, wanted, out=folder, force=force)
    if force and "bag" in wanted:
        _remove_bag(folder / PRODUCTS["bag"][0])
    say = tell or (lambda _: None)
    place = {product: folder / names[0] for product, names in PRODUCTS.items()}
    files: list[Path] = []
    if "recording" in wanted:
        files.append(save_recording(recording, place["recording"]))
    if "report" in wanted:
        files.append(write_report(recording, place["report"], progress=say))
    if "plots" in wanted:
        files += _plots(recording, folder, say)
    if "page" in wanted:
        say("building the 3D page")
        files.append(export_html(recording, place["page"]))
    if "csv" in wanted:
        say("writing the table")
        files.append(write_csv(recording, place["csv"]))
    if "bag" in wanted:
        say("writing the bag")
        files.append(write_bag(recording, place["bag"]))
    return files


def _remove_bag(bag: Path) -> None:
    """Remove the folder of a bag. A folder with other files stays.

    Raises:
        OutputError: the folder has other files, or it cannot be removed.
    """
    if not bag.exists():
        return
    inside = {file.name for file in bag.iterdir()} if bag.is_dir() else {""}
    if bag.is_symlink() or not inside <= {"metadata.yaml", f"{bag.name}.mcap"}:
        raise OutputError(f"{bag} is no bag of coopqp and was not replaced. Give another folder.")
    try:
        shutil.rmtree(bag)
    except OSError as error:
        raise OutputError(f"cannot replace {bag}: {error.strerror}. Give another folder.") from error


def save_recording(recording: Recording, file: Path) -> Path:
    """Write a recording, and its folder."""
    with folder_of(file):
        return recording.save(file)


def _plots(recording: Recording, folder: Path, say: Callable[[str], None]) -> list[Path]:
    from coopqp.simulation.evaluation.metrics import read_run
    from coopqp.simulation.evaluation.wrenches import read_loads
    from coopqp.visualization import plots
    from coopqp.visualization.joints import joint_figure
    from coopqp.visualization.loads import run_loads_figure
    from coopqp.visualization.style import figure_bytes
    from coopqp.visualization.timeline import timeline_figure

    say("drawing the pictures")
    cell = recording.cell()
    size, body = read_object(recording.metadata, recording.T_object_tool)
    figures = {
        "timeline.png": timeline_figure(recording, read_run(cell, recording)),
        "joints.png": joint_figure(cell, recording),
    }
    if cell.visual_model().ngeoms:
        figures["motion.png"] = plots.motion_figure(
            cell, recording, object_size=(size[0], size[1], size[2]), T_object_body=body, pixels=600
        )
    loads = read_loads(cell, recording)
    if loads is not None:
        figures["loads.png"] = run_loads_figure(cell, loads)
    return write_files({folder / name: figure_bytes(figure) for name, figure in figures.items()})


def safe_name(name: str) -> str:
    """A valid folder name from a name: letters, digits, dots, dashes and underscores, no dot first."""
    plain = "".join(c if c.isalnum() or c in "._-" else "_" for c in name).lstrip(".")
    if not plain:
        raise OutputError(f"'{name}' makes no name for a folder. Give one with --out.")
    return plain
