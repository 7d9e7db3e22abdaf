"""Headless Chromium over its DevTools protocol: opens a page, takes screenshots and clicks.

For the tests of what a browser shows, and for pictures of it on the pages. `make browser` installs Chromium.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
#: Software rendering, so that pages with WebGL draw without a graphics card.
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--no-default-browser-check",
    "--hide-scrollbars",
    "--mute-audio",
)

Picture = NDArray[np.int16]


def find_browser() -> str | None:
    """Path of an installed Chromium, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Page:
    """One page in a separate browser.

    Attributes:
        errors: errors on the page's console, and uncaught exceptions.
        requests: every requested address.
    """

    def __init__(self, program: str, profile: Path, *, width: int = 1280, height: int = 800) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._count = 0
        self._process = subprocess.Popen(
            [program, *_FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0",
             f"--window-size={width},{height}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            port = self._port(profile / "DevToolsActivePort")
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=30) as answer:
                target = next(t for t in json.load(answer) if t["type"] == "page")
            self._socket = connect(target["webSocketDebuggerUrl"], max_size=None, open_timeout=30)
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.call(f"{domain}.enable")
            self.call(
                "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
            )
        except BaseException:
            self._process.kill()
            raise

    def _port(self, file: Path) -> str:
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                raise RuntimeError(f"the browser ended with status {self._process.returncode}")
            if file.is_file() and (lines := file.read_text().splitlines()):
                return lines[0]
            time.sleep(0.05)
        raise TimeoutError("the browser opened no DevTools port within 60 s")

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError, TimeoutError):
            self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a DevTools command and return its answer. Events before the answer are recorded."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=120))
            if message.get("id") == self._count:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                result: dict[str, Any] = message["result"]
                return result
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        kind, detail = message.get("method"), message.get("params", {})
        if kind == "Runtime.exceptionThrown":
            self.errors.append(str(detail["exceptionDetails"].get("exception", detail["exceptionDetails"])))
        elif kind == "Runtime.consoleAPICalled" and detail["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(a.get("value", a.get("description", a))) for a in detail["args"]))
        elif kind == "Log.entryAdded" and detail["entry"]["level"] == "error":
            self.errors.append(f"{detail['entry']['text']} {detail['entry'].get('url', '')}")
        elif kind == "Network.requestWillBeSent":
            self.requests.append(detail["request"]["url"])

    def open(self, url: str) -> None:
        """Open an address."""
        self.call("Page.navigate", url=url)

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(str(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def wait_until(self, condition: Callable[[], Any], *, timeout: float = 300.0, every: float = 0.25) -> Any:
        """Wait until a condition is true; return its value."""
        deadline = time.monotonic() + timeout
        while not (value := condition()):
            if time.monotonic() > deadline:
                raise TimeoutError(f"not true within {timeout:g} s; the page's errors: {self.errors}")
            time.sleep(every)
        return value

    def screenshot(self, file: Path | None = None) -> Picture:
        """A screenshot (height, width, 3); also written to ``file``."""
        png = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if file is not None:
            file.write_bytes(png)
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), dtype=np.int16)

    def settled(self, *, timeout: float = 60.0, every: float = 0.5) -> Picture:
        """A screenshot after two equal ones in a row, half a second apart, or another time [s]."""
        last = [self.screenshot()]

        def still() -> bool:
            picture = self.screenshot()
            same = np.array_equal(picture, last[0])
            last[0] = picture
            return same

        self.wait_until(still, timeout=timeout, every=every)
        return last[0]

    def press(self, x: float, y: float) -> None:
        """Click at a position of the page [px]."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def box(self, selector: str) -> dict[str, float]:
        """Left, top, width and height [px] of the first element of a selector."""
        found: dict[str, float] = self.evaluate(
            f"(() => {{ const r = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
            " return {left: r.left, top: r.top, width: r.width, height: r.height}; })()"
        )
        return found

    def pause(self) -> None:
        """Press the space bar, which pauses the playback of viser's page."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, code="Space", key=" ", windowsVirtualKeyCode=32)
