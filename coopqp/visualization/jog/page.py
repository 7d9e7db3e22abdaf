"""The page of an operator in the browser: the cell as it is now, and what leads it. Needs the extra ``viewer``."""

from __future__ import annotations

import json
import math
import secrets
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.control.interface import Status
from coopqp.simulation.recording.recording import Recording
from coopqp.visualization.guarded import OwnScript
from coopqp.visualization.jog.seen import SILENCE, Seen
from coopqp.visualization.run_view import Stage
from coopqp.visualization.viewer import frame_camera, open_server, plain_text, stop_server, title_of

#: Length of a message of the page's script [characters].
_LONGEST = 1000
#: Speed of the hand at first, smallest and largest [m/s]; it turns with this many radians per metre.
_SPEED, _SLOWEST, _FASTEST, _SPIN = 0.1, 0.01, 0.25, 4.0
#: A gizmo's target is told so often [s], and until the object has moved less than this [m] for a while [s].
_TELL_EVERY, _STILL, _STILL_FOR = 0.03, 2e-4, 0.6
#: Texts are written anew so often at most [s].
_TEXT_EVERY = 0.1
KEYS_HELP = (
    "**Keys**: W S, A D, R F move along x, y, z; U O, I K, J L turn about them; space pauses.  \n**Game pad**: left "
    "stick x, y; triggers z; right stick and bumpers turn; B pauses."
)

#: Makes a call of the operator: its name, its values, and those by name.
Tell = Callable[..., None]


@final
class JogPage:
    """Serves the page. The first page that is opened leads, the others watch; when it closes the next one leads.

    Args:
        recording: the cell at its start, as a run of one step.
        tell: makes a call of the operator, or says ``"beat"``: the leading page lives. Called from any thread.
        port: port to listen on; 0 for any free port.
        sticks: draw the arms as sticks instead of their shapes.
        override: where the slider begins.

    Attributes:
        url: address for the browser. It has a key, without which the server answers nobody.
        override: as it was asked for last.

    Raises:
        SceneError, MissingExtraError, InvalidInputError: as :class:`coopqp.visualization.LiveViewer`.
    """

    def __init__(
        self, recording: Recording, tell: Tell, *, port: int = 8080, sticks: bool = False, override: float = 1.0
    ) -> None:
        self._tell, self.override = tell, override
        self._lock = threading.RLock()
        self._pages: list[_Lead | _Watcher] = []  # the first one leads
        self._lead_key, self._heard = "", -math.inf
        self._text_due, self._said = -math.inf, ""
        script = OwnScript(Path(__file__).with_name("keys.js").read_text(encoding="utf-8"), self._hear)
        self._server, self.url = open_server("127.0.0.1", port, script)
        try:
            self.stage = Stage(self._server.scene, recording, sticks=sticks)
            self.pose = self.stage.place(recording.q[0], ())
            frame_camera(self._server, self.stage)
            gui = self._server.gui
            gui.configure_theme(show_share_button=False)
            gui.main_panel.dock_right()
            gui.add_markdown(f"**{plain_text(title_of(recording)[0])}**")
            self._text = gui.add_markdown("")
            self._server.on_client_connect(self._came)
            self._server.on_client_disconnect(self._left)
        except BaseException:
            stop_server(self._server)
            raise

    def close(self) -> None:
        """Stop serving."""
        stop_server(self._server)

    # -- pages -----------------------------------------------------------------------------------------------------

    def _came(self, client: Any) -> None:
        with self._lock:
            self._pages.append(_Watcher(client))
            self._next_leads()

    def _left(self, client: Any) -> None:
        with self._lock:
            led = bool(self._pages) and self._pages[0].client.client_id == client.client_id
            self._pages = [page for page in self._pages if page.client.client_id != client.client_id]
            if led:
                self._lead_key, self._heard = "", -math.inf
                self._tell("pause")
                self._next_leads()

    def _next_leads(self) -> None:
        if self._pages and isinstance(self._pages[0], _Watcher):
            watcher = self._pages[0]
            watcher.text.remove()
            self._lead_key = secrets.token_hex(8)
            self._heard = time.monotonic()
            self._pages[0] = _Lead(watcher.client, self, self._lead_key, self.stage.cell.arm_names)

    @property
    def lead(self) -> _Lead | None:
        """The page that leads; None without one."""
        pages = self._pages
        return pages[0] if pages and isinstance(pages[0], _Lead) else None

    @property
    def lives(self) -> bool:
        """Whether the leading page has been heard of lately."""
        return time.monotonic() - self._heard < SILENCE

    async def _hear(self, connection: Any) -> None:
        """Serve the socket of a page's script."""
        async for message in connection:
            if len(message) <= _LONGEST:
                self._take(message)

    def _take(self, message: str | bytes) -> None:
        """A message of a script: that its page lives, and what keys and game pad ask for. Others are left out."""
        try:
            said = json.loads(message)
            twist = np.array(said.get("twist", []), dtype=float)
        except (ValueError, TypeError, AttributeError, RecursionError):
            return
        lead = self.lead
        if lead is None or not self._lead_key or said.get("token") != self._lead_key:
            return
        self._heard = time.monotonic()
        self._tell("beat")
        if said.get("call") == "pause":
            self.call("pause")
        if twist.shape == (6,) and np.isfinite(twist).all():
            lead.drops()
            speed = float(lead.speed.value)
            scale = speed * np.array([1.0, 1.0, 1.0, _SPIN, _SPIN, _SPIN])
            self._tell("jog", (np.clip(twist, -1.0, 1.0) * scale).tolist(), frame=str(lead.frame.value))

    def call(self, name: str, *values: Any, **named: Any) -> None:
        """Make a call of the operator's; a gizmo leads no more."""
        lead = self.lead
        if lead is not None and name != "set_override":
            lead.drops()
        self._tell(name, *values, **named)

    def tell(self, name: str, *values: Any) -> None:
        """Make a call of the gizmo's."""
        self._tell(name, *values)

    # -- drawing ---------------------------------------------------------------------------------------------------

    def show(self, seen: Seen) -> None:
        """Show the cell as it is now."""
        now = time.monotonic()
        self.override = seen.override
        text = "\n\n".join(seen.lines())
        with self._server.atomic():
            self.pose = self.stage.place(seen.q, seen.binding)
            if text != self._said and now >= self._text_due:
                self._said, self._text_due = text, now + _TEXT_EVERY
                self._text.content = "\n\n".join(plain_text(line) for line in seen.lines())
            lead = self.lead
            if lead is not None:
                lead.follow(seen, self.pose, now)


@final
class _Watcher:
    """A page that watches."""

    def __init__(self, client: Any) -> None:
        self.client = client
        self.text = client.gui.add_markdown("Another page leads; this one watches.")


@final
class _Lead:
    """The controls of the page that leads."""

    def __init__(self, client: Any, page: JogPage, key: str, arms: tuple[str, ...]) -> None:
        self.client, self._page = client, page
        gui = client.gui
        pause = gui.add_button("Pause", color="red")
        pause.on_click(lambda _: page.call("pause"))
        program = gui.add_button_group("program", ("Run", "Back", "Step"))
        calls = {"Run": "forward", "Back": "reverse", "Step": "step_to_mark", "Return": "return_to_path"}
        program.on_click(lambda event: page.call(calls[event.target.value]))
        hand = gui.add_button_group("by hand", ("Return", "Reset"))
        hand.on_click(lambda event: page.call(calls.get(event.target.value, "reset")))
        self.override = gui.add_slider(
            "override [%]", min=0, max=100, step=1, initial_value=round(100.0 * page.override)
        )
        self.override.on_update(lambda _: page.call("set_override", self.override.value / 100.0))
        self.speed = gui.add_slider("hand [m/s]", min=_SLOWEST, max=_FASTEST, step=0.01, initial_value=_SPEED)
        self.frame = gui.add_dropdown("axes", ("world", "object", *arms), initial_value="world")
        gui.add_markdown(KEYS_HELP)
        gui.add_html(f'<span data-coopqp-lead="{key}"></span>')
        self._gizmo = client.scene.add_transform_controls("/hand", scale=0.3, depth_test=False)
        self._gizmo.on_update(self._dragged)
        self._grabbed = self._engaged = False
        self._told, self._moved, self._last = -math.inf, -math.inf, np.zeros(3)

    async def _dragged(self, event: Any) -> None:
        """The gizmo is grabbed, moved or let go."""
        if event.phase == "start":
            self._grabbed = self._engaged = True
            self._moved = time.monotonic()
            self._page.tell("engage", self._hand().homogeneous)
        elif event.phase == "end":
            self._grabbed, self._moved = False, time.monotonic()
        if self._engaged:
            self._lead_there()

    def _hand(self) -> pin.SE3:
        w, x, y, z = (float(value) for value in self._gizmo.wxyz)
        return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(self._gizmo.position, dtype=float))

    def _lead_there(self) -> None:
        self._told = time.monotonic()
        self._page.tell("target", self._hand().homogeneous)

    def drops(self) -> None:
        """The gizmo leads no more."""
        self._engaged = False

    def follow(self, seen: Seen, pose: pin.SE3, now: float) -> None:
        """Tell the gizmo's target again, or put the gizmo where the object is."""
        if self._engaged:
            if np.abs(pose.translation - self._last).max() > _STILL or seen.status != Status.JOGGING.value:
                self._last, self._moved = pose.translation, now
            if not self._grabbed and now - self._moved > _STILL_FOR:
                self._engaged = False
                self._page.tell("release")
            elif self._page.lives and now - self._told >= _TELL_EVERY:
                self._lead_there()
            return
        if not self._grabbed:
            x, y, z, w = pin.Quaternion(pose.rotation).coeffs()
            self._gizmo.wxyz, self._gizmo.position = (w, x, y, z), pose.translation
