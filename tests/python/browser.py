"""A headless Chromium for tests of pages: DevTools protocol, and real waiting."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-background-networking",
    "--remote-debugging-port=0",
    "about:blank",
]


def why_not() -> str | None:
    """What is missing for it; None when everything is there."""
    if not any(map(shutil.which, PROGRAMS)):
        return "no Chromium: apt-get install chromium (on Ubuntu: install google-chrome)"
    try:
        import websockets.sync.client  # noqa: F401
    except ImportError:
        return "no package websockets: pip install websockets"
    return None


class Browser:
    """A browser with a window of a size."""

    def __init__(self, width: int = 800, height: int = 600) -> None:
        """Start it."""
        program = next(filter(None, map(shutil.which, PROGRAMS)))
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        size = f"--window-size={width},{height}"
        command = [program, f"--user-data-dir={self.folder.name}", size, *FLAGS]
        # The browser's messages are discarded: a full pipe that nobody reads would block it.
        self.process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        told, end = Path(self.folder.name) / "DevToolsActivePort", time.monotonic() + 120.0
        while not told.exists() or "\n" not in told.read_text("utf-8"):
            assert self.process.poll() is None, f"{program} ended: {self.process.returncode}"
            assert time.monotonic() < end, f"{program} opens no port"
            time.sleep(0.05)
        self.port = int(told.read_text("utf-8").split()[0])
        self.size = (width, height)

    def page(self, address: str) -> Page:
        """Open a page of its own."""
        url = f"http://127.0.0.1:{self.port}/json/new?about:blank"
        with urllib.request.urlopen(urllib.request.Request(url, method="PUT")) as answer:
            target = json.load(answer)["webSocketDebuggerUrl"]
        page = Page(target)
        width, height = self.size
        page.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        page.call("Page.navigate", url=address)
        return page

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait()
        self.folder.cleanup()

    def __enter__(self) -> Browser:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.close()


class Page:
    """A page of a browser."""

    def __init__(self, target: str) -> None:
        """Connect to it."""
        from websockets.sync.client import connect

        self.socket = connect(target, max_size=None)
        self.number = 0

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """A call of the DevTools protocol."""
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": params}))
        while True:
            answer = json.loads(self.socket.recv(timeout=120))
            if answer.get("id") == self.number:
                assert "error" not in answer, answer
                return answer["result"]

    def evaluate(self, code: str) -> Any:
        """The value of an expression of JavaScript."""
        result = self.call("Runtime.evaluate", expression=code, returnByValue=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait_for(self, code: str, seconds: float = 120.0) -> Any:
        """Wait until an expression is true; returns it."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            value = self.evaluate(code)
            if value:
                return value
            time.sleep(0.1)
        raise AssertionError(f"after {seconds} s: {code} is {value!r}")

    def picture(self) -> bytes:
        """The page as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
