"""Runs in a browser through viser: live with play, pause and scrub, or as one offline page.

Needs the extra ``viewer``. Nothing is sent to other machines: by default the live viewer listens on this machine only,
it refuses requests of foreign pages and programs, and the page contains all its data.
"""

from __future__ import annotations

import contextlib
import html
import io
import string
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.checks import as_scalar
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.lazy import needed
from coopqp.output import check_file, write_files
from coopqp.simulation.evaluation.assessment import worst_status
from coopqp.simulation.recording.recording import Recording
from coopqp.visualization.guarded import OwnScript, guarded_servers
from coopqp.visualization.panel_page import (
    band_piece,
    cursor_style,
    curve_piece,
    head_piece,
    joints_piece,
    panel_page,
    panel_style,
    plot_piece,
)
from coopqp.visualization.run_panel import Moment, RunPanel
from coopqp.visualization.run_view import FIELD_OF_VIEW, Stage

#: Pictures per second of the page, and their largest number.
FRAMES_PER_SECOND, MAX_FRAMES = 25.0, 500
#: Pause of the page at the end, before it starts again [s].
PAUSE_AT_END = 1.5
#: Redraws per second of the live viewer.
LIVE_RATE = 30.0
#: What the page of a run explains, and what makes a page dark.
_LEGEND = (
    '<br><i style="background: #4c84bf"></i>the object (grey: its start and end)<br>'
    '<i style="background: #0072b2; height: .25em; vertical-align: .2em"></i>paths of its frame and of the grasps<br>'
    '<i style="background: #d61e1e"></i>an arm at a limit, named above it, or bodies too close<br>'
    "Drag to turn, scroll to zoom; the space bar plays and pauses."
)
_DARK = (
    "<script>if (window.__VISER_EMBED_CONFIG__) window.__VISER_EMBED_CONFIG__.darkMode = "
    'matchMedia("(prefers-color-scheme: dark)").matches;</script>'
)
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x", "10x")


def require_viser() -> Any:
    """The package viser.

    Raises:
        MissingExtraError: viser is not installed.
    """
    return needed("viser", "viewer", "viser")


def _serve(viser: Any, host: str, port: int, script: OwnScript | None = None) -> tuple[Any, str]:
    """Start a server of viser without its printed banner; return it and its address. It refuses foreign requests."""
    server = None
    try:
        with guarded_servers(host, script) as key, contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=host, port=port, verbose=False)
    except CoopqpError:
        stop_server(server)
        raise
    return server, f"http://{host}:{server.get_port()}/{key}"


@contextlib.contextmanager
def offline() -> Iterator[Any]:
    """A server whose scene becomes a page."""
    server, _ = _serve(require_viser(), "127.0.0.1", 0)
    try:
        yield server
    finally:
        stop_server(server)


def open_server(host: str, port: int, script: OwnScript | None = None) -> tuple[Any, str]:
    """A server of viser and its address, or a named error; :func:`stop_server` ends it."""
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


def frame_camera(server: Any, stage: Stage) -> None:
    """Let the camera of each new page see the whole scene."""
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
    mark: Callable[[Any], None] | None = None,
) -> Path:
    """Write a run as one offline page with play, pause, scrub and speed.

    Args:
        recording: the run.
        file: path of the page.
        sticks: draw the arms as sticks instead of their shapes.
        progress: called as ``progress(pictures done, pictures)``.
        mark: called with the scene of viser before the first picture, to add what stands.

    Raises:
        SceneError: the recording does not describe its cell, or a mesh file is missing.
        OutputError: the file cannot be written.
        MissingExtraError: viser is not installed.
    """
    page = Path(file)
    check_file(page)
    write_files({page: run_page(recording, sticks=sticks, progress=progress, mark=mark).encode()})
    return page


def run_page(
    recording: Recording,
    *,
    sticks: bool = False,
    progress: Callable[[int, int], None] | None = None,
    mark: Callable[[Any], None] | None = None,
) -> str:
    """The page of :func:`export_html` as one HTML document that loads nothing else. Same arguments and errors."""
    with offline() as server:
        stage = Stage(server.scene, recording, sticks=sticks)
        if mark is not None:
            mark(server.scene)
        frame_camera(server, stage)
        panel = RunPanel(stage.cell, recording, stage.readings)
        duration = float(recording.time[-1])
        n_frames = int(np.clip(np.ceil(FRAMES_PER_SECOND * duration - 1e-6), 2, MAX_FRAMES))
        times = np.linspace(0.0, duration, n_frames)
        samples = np.clip(np.searchsorted(recording.time, times - 1e-9), 0, recording.n_steps)
        serializer, moments = server.get_scene_serializer(), []
        for done, sample in enumerate(samples, start=1):
            stage.show(int(sample))
            moments.append(panel.moment(int(sample)))
            serializer.insert_sleep(float(times[1] - times[0]) if done < n_frames else PAUSE_AT_END)
            if progress is not None:
                progress(done, n_frames)
        document: str = serializer.as_html()
    name, made = title_of(recording)
    beside = panel_page(panel, moments, until=panel.end + PAUSE_AT_END)
    return page_of(document, name, html.escape(made), beside=beside, legend=_LEGEND)


def page_of(document: str, title: str, subtitle: str, *, legend: str, beside: str = "") -> str:
    """A scene's document with a card of a title; subtitle, legend and what stands beside the scene are HTML.

    The page is dark where its reader's browser is.
    """
    template = string.Template(Path(__file__).with_name("card.html").read_text(encoding="utf-8"))
    card = template.substitute(title=html.escape(title), subtitle=subtitle, legend=legend) + beside
    before, found, rest = document.partition("</head>")
    document = f"{before}{_DARK}{found}{rest}" if found else document
    head, found, tail = document.rpartition("</body>")
    return f"{head}{card}{found}{tail}" if found else f"{document}{card}"


class LiveViewer:
    """A server on this machine that shows a run in the browser, with play, pause, scrub and speed.

    Beside the scene stand the same curves, statuses and joints as on the page of :func:`export_html`.

    Args:
        recording: the run.
        host: address to listen on; only this machine can reach the default.
        port: port to listen on; 0 for any free port.
        sticks: draw the arms as sticks instead of their shapes.

    Attributes:
        url: address for the browser. It has a key, without which the server answers nobody.

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
        self._server, self.url = open_server(host, port)
        try:
            show()
        except BaseException:
            stop_server(self._server)
            raise

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
        self._look(dark=False)
        gui.main_panel.dock_right()
        name, made = title_of(recording)
        gui.add_markdown(f"**{plain_text(name)}**\n\n{plain_text(made)}")
        end = max(float(recording.time[-1]), 1e-6)
        self.panel = RunPanel(self.stage.cell, recording, self.stage.readings)
        gui.add_html(panel_style(self.panel, until=end))
        self._time = gui.add_slider("time [s]", min=0.0, max=end, step=end / 2000.0, initial_value=0.0)
        self._playing = gui.add_checkbox("play", initial_value=True)
        self._speed = gui.add_dropdown("speed", SPEEDS, initial_value="1x")
        self._add_panel(self.panel.moment(0))
        dark = gui.add_checkbox("dark", initial_value=False)
        dark.on_update(lambda _: self._look(dark=dark.value))
        self._clock, self._slider = 0.0, self._time.value  # the clock also counts the pause at the end
        self._show(0)

    def _look(self, *, dark: bool) -> None:
        self._server.gui.configure_theme(show_share_button=False, control_width="medium", dark_mode=dark)

    def _add_panel(self, moment: Moment) -> None:
        """Add the pieces of the panel; those in ``_changing`` are sent again where they change."""
        gui, panel = self._server.gui, self.panel
        self._changing = [gui.add_html(head_piece(moment))]
        gui.add_html(band_piece(panel))
        for k, (curve, value) in enumerate(zip(panel.curves, moment.values, strict=True)):
            self._changing.append(gui.add_html(curve_piece(curve, value)))
            gui.add_html(plot_piece(panel, curve, last=k == len(panel.curves) - 1))
        self._changing += [gui.add_html(joints_piece(panel, moment)), gui.add_html(cursor_style(panel, moment))]

    def _show(self, sample: int) -> None:
        moment = self.panel.moment(sample)
        values = zip(self.panel.curves, moment.values, strict=True)
        contents = [head_piece(moment), *(curve_piece(curve, value) for curve, value in values)]
        contents += [joints_piece(self.panel, moment), cursor_style(self.panel, moment)]
        with self._server.atomic():
            self.stage.show(sample)
            for piece, content in zip(self._changing, contents, strict=True):
                if piece.content != content:
                    piece.content = content
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
