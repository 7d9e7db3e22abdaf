"""Runs in a browser through viser: live with play, pause and scrub, or as one offline page.

Needs the extra ``viewer``. Nothing is sent to other machines: by default the live viewer listens on this machine only,
it refuses requests of foreign pages, and the page contains all its data.
"""

from __future__ import annotations

import contextlib
import html
import io
import string
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.checks import as_scalar
from coopqp.control.interface import Status
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.lazy import needed
from coopqp.output import check_file, write_files
from coopqp.simulation.evaluation.figures import worst_status
from coopqp.simulation.recording.recording import Recording
from coopqp.visualization.cell_overview import Glance, shortfall
from coopqp.visualization.guarded import OwnScript, guarded_servers
from coopqp.visualization.run_view import ALERT, FIELD_OF_VIEW, READOUT_SHARE, Stage

#: Pictures per second of the page, and their largest number.
FRAMES_PER_SECOND, MAX_FRAMES = 25.0, 500
#: Longest line of the readout in characters; it fits a window of 800 pixels.
LINE = 60
#: Pause of the page at the end, before it starts again [s].
PAUSE_AT_END = 1.5
#: Redraws per second of the live viewer.
LIVE_RATE = 30.0
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x", "10x")


def require_viser() -> Any:
    """The package viser.

    Raises:
        MissingExtraError: viser is not installed.
    """
    return needed("viser", "viewer", "viser")


def _serve(viser: Any, host: str, port: int, script: OwnScript | None = None) -> Any:
    """Start a server of viser without its printed banner. It refuses requests of foreign pages."""
    server = None
    try:
        with guarded_servers(host, script), contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=host, port=port, verbose=False)
    except CoopqpError:
        stop_server(server)
        raise
    return server


@contextlib.contextmanager
def _offline(page: Path) -> Iterator[Any]:
    """A server whose scene becomes a page."""
    viser = require_viser()
    check_file(page)
    server = _serve(viser, "127.0.0.1", 0)
    try:
        yield server
    finally:
        stop_server(server)


def open_server(host: str, port: int, script: OwnScript | None = None) -> Any:
    """A server of viser, or a named error; :func:`stop_server` ends it."""
    viser = require_viser()
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port < 65536:
        raise InvalidInputError(f"port is {port!r}", "LiveViewer", "Give a number from 0 (any) to 65535.")
    try:
        return _serve(viser, host, port, script)
    except OSError as error:
        raise InvalidInputError(f"cannot listen on {host}:{port} ({error})", "LiveViewer", "Use --port 0.") from error


def stop_server(server: Any) -> None:
    """Stop serving."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def title_of(recording: Recording) -> tuple[str, str]:
    """Title and subtitle of a run: its name; its controller and number of steps."""
    data = recording.metadata
    name = str(data.get("scenario") or data.get("name") or "A run").replace("_", " ")
    controller = str(data.get("controller", "an unknown controller"))
    return name, f"{controller}, {recording.n_steps} steps, {recording.time[-1]:.4g} s, {worst_status(recording)}"


def readout(stage: Stage, sample: int) -> str:
    """Lines for a sample: clock, rate and status; binding limits; errors. Long ones are broken, not cut."""
    run, errors = stage.recording, stage.readings
    step = min(sample, run.n_steps - 1)
    end = float(run.metadata.get("duration", run.clock[-1]))
    share = f"{100.0 * run.clock[sample] / end:.0f} % of the path · " if 0.0 < end < np.inf else ""
    limits = "; ".join(str(limit) for limit in stage.limits(sample)) or stage.reason(sample) or "no limit binds"
    status = list(Status)[int(run.status[step])].value
    lines = (
        f"t = {run.time[sample]:.2f} s · {share}{status}, σ = {100.0 * run.rate[step]:.3g} %",
        limits,
        f"ε_p {_length(errors.eps_p_mm[sample])} · chain error {_length(errors.chain_mm[sample])}, "
        f"{_angle(errors.chain_deg[sample])}",
    )
    return "\n".join(part for line in lines for part in textwrap.wrap(line, LINE, break_on_hyphens=False))


def _length(mm: float) -> str:
    """A length in millimetres, or in micrometres if it is small."""
    if mm < 1e-6:
        return "below 0.001 µm"
    return f"{1e3 * mm:.2g} µm" if mm < 0.01 else f"{mm:.3g} mm"


def _angle(deg: float) -> str:
    return "below 1e-6°" if deg < 1e-6 else f"{deg:.2g}°"


def frame_camera(server: Any, stage: Stage) -> None:
    """Let new pages look at the whole scene."""
    position, target = stage.camera()
    server.scene.set_up_direction("+z")
    server.initial_camera.position = tuple(float(x) for x in position)
    server.initial_camera.look_at = tuple(float(x) for x in target)
    server.initial_camera.fov = float(np.deg2rad(FIELD_OF_VIEW))


def export_html(
    recording: Recording,
    file: str | Path,
    *,
    sticks: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a run as one offline page with play, pause, scrub and speed.

    Args:
        recording: the run.
        file: path of the page.
        sticks: draw the arms as sticks instead of their shapes.
        progress: called as ``progress(pictures done, pictures)``.

    Raises:
        SceneError: the recording does not describe its cell, or a mesh file is missing.
        OutputError: the file cannot be written.
        MissingExtraError: viser is not installed.
    """
    page = Path(file)
    with _offline(page) as server:
        stage = Stage(server.scene, recording, sticks=sticks)
        frame_camera(server, stage)
        hud = server.scene.add_label(
            "/readout",
            readout(stage, 0),
            position=stage.above(READOUT_SHARE),
            anchor="bottom-center",
            font_screen_scale=1.15,
        )
        duration = float(recording.time[-1])
        n_frames = int(np.clip(np.ceil(FRAMES_PER_SECOND * duration - 1e-6), 2, MAX_FRAMES))
        times = np.linspace(0.0, duration, n_frames)
        samples = np.clip(np.searchsorted(recording.time, times - 1e-9), 0, recording.n_steps)
        serializer = server.get_scene_serializer()
        for done, sample in enumerate(samples, start=1):
            stage.show(int(sample))
            hud.text = readout(stage, int(sample))
            serializer.insert_sleep(float(times[1] - times[0]) if done < n_frames else PAUSE_AT_END)
            if progress is not None:
                progress(done, n_frames)
        document: str = serializer.as_html()
    name, made = title_of(recording)
    return _write_page(page, document, name, html.escape(made))


def _write_page(page: Path, document: str, title: str, subtitle: str) -> Path:
    """Write a page with a card of a title, and of a subtitle in HTML."""
    template = string.Template(Path(__file__).with_name("card.html").read_text(encoding="utf-8"))
    card = template.substitute(title=html.escape(title), subtitle=subtitle)
    head, found, tail = document.rpartition("</body>")
    write_files({page: f"{head}{card}{found}{tail}".encode() if found else f"{document}{card}".encode()})
    return page


class LiveViewer:
    """A server on this machine that shows a run in the browser, with play, pause, scrub, speed and readouts.

    Args:
        recording: the run.
        host: address to listen on; only this machine can reach the default.
        port: port to listen on; 0 for any free port.
        sticks: draw the arms as sticks instead of their shapes.

    Attributes:
        url: address for the browser.

    Raises:
        SceneError, MissingExtraError: as in :func:`export_html`.
        InvalidInputError: an invalid port, or a port in use.
    """

    def __init__(
        self, recording: Recording, *, host: str = "127.0.0.1", port: int = 8080, sticks: bool = False
    ) -> None:
        self._open(lambda: self._show_run(recording), host=host, port=port, sticks=sticks)

    def _open(self, show: Callable[[], None], *, host: str, port: int, sticks: bool) -> None:
        self._sticks = sticks
        self._server = open_server(host, port)
        try:
            show()
        except BaseException:
            stop_server(self._server)
            raise
        self.url = f"http://{host}:{self._server.get_port()}"

    def _show_run(self, recording: Recording) -> None:
        self.stage = Stage(self._server.scene, recording, sticks=self._sticks)
        frame_camera(self._server, self.stage)
        self._add_controls(recording)

    def __enter__(self) -> LiveViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving."""
        stop_server(self._server)

    def _add_controls(self, recording: Recording) -> None:
        gui = self._server.gui
        gui.configure_theme(show_share_button=False)
        name, made = title_of(recording)
        gui.add_markdown(f"**{plain_text(name)}**\n\n{plain_text(made)}")
        end = max(float(recording.time[-1]), 1e-6)
        self._time = gui.add_slider("time [s]", min=0.0, max=end, step=end / 2000.0, initial_value=0.0)
        self._playing = gui.add_checkbox("play", initial_value=True)
        self._speed = gui.add_dropdown("speed", SPEEDS, initial_value="1x")
        self._text = gui.add_markdown("")
        self._clock, self._slider = 0.0, self._time.value  # the clock also counts the pause at the end
        self._show(0)

    def _show(self, sample: int) -> None:
        with self._server.atomic():
            self.stage.show(sample)
            self._text.content = "\n\n".join(plain_text(line) for line in readout(self.stage, sample).split("\n"))
        self._shown = sample

    def update(self, elapsed: float) -> int:
        """Advance by a time [s] while playing, or follow a moved slider. Returns the shown sample."""
        run = self.stage.recording
        end = float(run.time[-1])
        seconds = as_scalar(elapsed, "LiveViewer.update: elapsed", open_low=False)
        if self._time.value != self._slider:
            self._clock = float(self._time.value)
        elif self._playing.value:
            self._clock += seconds * float(self._speed.value.rstrip("x"))
            if self._clock > end + PAUSE_AT_END:
                self._clock = 0.0
        shown = min(self._clock, end)
        if shown != self._time.value:
            self._time.value = shown
        self._slider = self._time.value
        sample = run.sample_at(shown + 1e-9)
        if sample != self._shown:
            self._show(sample)
        return sample

    def run(self) -> None:
        """Serve until an interrupt (Ctrl-C)."""
        last = time.monotonic()
        while True:
            time.sleep(1.0 / LIVE_RATE)
            now = time.monotonic()
            self.update(now - last)
            last = now


def plain_text(text: str) -> str:
    """Text with escaped Markdown characters."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#|~" else c for c in text)


class CellViewer(LiveViewer):
    """Shows a cell before it runs: its start, its path, how far its arms come, and what the check says; with Run.

    Args:
        found: the cell at a glance.
        run: runs it, when Run is pressed; called with ``progress``, as in :func:`coopqp.simulate`.
        more: further lines.
        host, port, sticks: as for :class:`LiveViewer`.

    Raises:
        SceneError, MissingExtraError, InvalidInputError: as :class:`LiveViewer`.
    """

    def __init__(
        self,
        found: Glance,
        run: Callable[..., Recording],
        *,
        more: str = "",
        host: str = "127.0.0.1",
        port: int = 8080,
        sticks: bool = False,
    ) -> None:
        self._run, self._asked, self._is_run = run, False, False
        self._open(lambda: self._show_cell(found, more), host=host, port=port, sticks=sticks)

    def _show_cell(self, found: Glance, more: str) -> None:
        self.stage = _glance_stage(self._server, found, sticks=self._sticks)
        gui = self._server.gui
        gui.configure_theme(show_share_button=False)
        verdict, *lines = [*found.lines(), *more.splitlines()]
        text = "\n\n".join(plain_text(line) for line in lines)
        gui.add_markdown(f"**{plain_text(found.name.replace('_', ' '))}**\n\n**{plain_text(verdict)}**\n\n{text}")
        self._button = gui.add_button("Run", color="blue")
        self._button.on_click(lambda _: self._press())
        self._text = gui.add_markdown("")

    def _press(self) -> None:
        self._asked = True

    def update(self, elapsed: float) -> int:
        """Wait for Run, then run the cell and show its run as :class:`LiveViewer` does."""
        if self._is_run:
            return super().update(elapsed)
        if self._asked:
            self._asked, self._button.disabled = False, True
            percent_shown = -1

            def progress(done: int, planned: int) -> None:
                nonlocal percent_shown
                if (percent := 100 * done // max(planned, 1)) != percent_shown:
                    percent_shown = percent
                    self._text.content = f"running: {min(percent, 100)} %"

            try:
                recording = self._run(progress=progress)
            except CoopqpError as error:
                self._text.content = f"**refused**\n\n{plain_text(' '.join(str(error).split()))}"
                self._button.disabled = False
                return 0
            self._server.scene.reset()
            self._server.gui.reset()
            self._show_run(recording)
            self._is_run = True
        return 0


def mark_glance(scene: Any, found: Glance) -> None:
    """Add the reach of the arms that miss their grasps to a scene of viser, and by how much they miss them."""
    for name, (tool, wanted) in found.targets().items():
        ring = found.reaches[name].ring(wanted[2]) if name in found.reaches else np.empty((0, 3))
        segments = np.stack([ring[:-1:2], ring[1::2]], axis=1) if len(ring) else np.empty((0, 2, 3))
        lines = np.concatenate([segments, [[tool, wanted]]]).astype(np.float32)
        scene.add_line_segments(f"/short/{name}", lines, colors=ALERT, thickness=3.0, thickness_units="screen")
        scene.add_label(f"/missed/{name}", shortfall(found, name), position=wanted, anchor="top-left")


def _glance_stage(server: Any, found: Glance, *, sticks: bool) -> Stage:
    """The scene of a cell before it runs, on a server."""
    stage = Stage(server.scene, found.recording(), sticks=sticks)
    stage.put_object(found.pose)
    mark_glance(server.scene, found)
    frame_camera(server, stage)
    return stage


def export_glance(found: Glance, file: str | Path, *, more: str = "", sticks: bool = False) -> Path:
    """Write what :class:`CellViewer` shows as one offline page, without Run. Errors as of :func:`export_html`."""
    page = Path(file)
    with _offline(page) as server:
        _glance_stage(server, found, sticks=sticks)
        serializer = server.get_scene_serializer()
        serializer.insert_sleep(1.0)
        document: str = serializer.as_html()
    verdict, *lines = [*found.lines(), *more.splitlines()]
    text = "<br>".join(html.escape(line) for line in lines)
    return _write_page(page, document, f"{found.name.replace('_', ' ')}: {verdict}", text)
