"""A cell in a browser before it runs: its start, its path, the reach of its arms, and what the check says; with Run.

Needs the extra ``viewer``.
"""

from __future__ import annotations

import html
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.errors import CoopqpError
from coopqp.output import check_file, write_files
from coopqp.simulation.recording.recording import Recording
from coopqp.visualization.cell_overview import Glance, shortfall
from coopqp.visualization.run_view import ALERT, Stage
from coopqp.visualization.viewer import LiveViewer, frame_camera, offline, page_of, plain_text

_REACH = (124, 130, 138)
#: What the page explains. Nothing on it plays.
_LEGEND = (
    '<br><i style="background: #0072b2; height: .25em; vertical-align: .2em"></i>path of the object and of the grasps'
    "<br>dashed: how far an arm comes at the height of its grasp; red: not far enough<br>Drag to turn, scroll to zoom."
    "<style>.mantine-Paper-root:has([class*=Slider-root]) { display: none !important; }</style>"
)


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
    """Add the reach of the arms at the heights of their grasps to a scene of viser, and by how much they miss them."""
    for name, wanted in found.grasps().items():
        ring = found.reaches[name].ring(wanted[2]) if name in found.reaches else np.empty((0, 3))
        if name not in found.short and len(ring):
            dashes = np.stack([ring[:-1:2], ring[1::2]], axis=1).astype(np.float32)
            scene.add_line_segments(f"/reach/{name}", dashes, colors=_REACH, thickness=1.5, thickness_units="screen")
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
    check_file(page)
    with offline() as server:
        _glance_stage(server, found, sticks=sticks)
        serializer = server.get_scene_serializer()
        serializer.insert_sleep(1.0)
        document: str = serializer.as_html()
    verdict, *lines = [*found.lines(), *more.splitlines()]
    text = "<br>".join(html.escape(line) for line in lines)
    title = f"{found.name.replace('_', ' ')}: {verdict}"
    write_files({page: page_of(document, title, text, legend=_LEGEND).encode()})
    return page
