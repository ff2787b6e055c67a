"""A headless browser for tests, spoken to by its DevTools protocol through pipes: no network."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def browser() -> str | None:
    """The path of a browser of the Chromium family; None: there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """A browser with one page, its `console` messages and the addresses of its `requests`."""

    def __init__(self, profile: Path) -> None:
        path = browser()
        assert path is not None
        reads, self._out = os.pipe()
        self._in, writes = os.pipe()
        high_in, high_out = (fcntl.fcntl(end, fcntl.F_DUPFD, 64) for end in (reads, writes))
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--disable-background-networking",
            f"--user-data-dir={profile}",
            "--remote-debugging-pipe",
        ]
        self._process = subprocess.Popen(
            ["bash", "-c", f'exec 3<&{high_in} 4>&{high_out}; exec "$@"', "bash", path, *options],
            pass_fds=(high_in, high_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for handle in (reads, writes, high_in, high_out):
            os.close(handle)
        self._number, self._rest = 0, b""
        self._session: str | None = None
        self.console: list[str] = []
        self.requests: list[str] = []
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        attached = self._call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            self._call(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.close(self._out)
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._in)

    def open(
        self, address: str, drawn: str = "document.documentElement?.dataset.numbers ?? ''"
    ) -> None:
        """Load a page and wait until it has drawn, which an expression tells."""
        self._call("Page.navigate", url="about:blank")
        self.console.clear()
        self.requests.clear()
        self._call("Page.navigate", url=address)
        for _ in range(1000):
            if self.value(drawn):
                return
            time.sleep(0.02)
        raise AssertionError(f"the page has drawn nothing: {self.console}")

    def value(self, expression: str) -> Any:
        """What an expression gives in the page."""
        answer = self._call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def looks(self, width: int, height: int, dark: bool = False) -> bytes:
        """A picture of the whole page (PNG)."""
        self.sized(width, height, dark)
        picture = self._call("Page.captureScreenshot", captureBeyondViewport=True)
        return base64.b64decode(picture["data"])

    def sized(self, width: int, height: int, dark: bool = False, idle: int = 300) -> None:
        """Take on the size of a screen, in light or dark.

        Two frames and a further while follow, in which a page redraws.

        Args:
            width, height: of the screen [px].
            dark: whether dark colours are preferred.
            idle: the while [ms]; 0 suffices for what style sheets alone arrange.
        """
        feature = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._call("Emulation.setEmulatedMedia", features=[feature])
        self._call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        frames = "new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))"
        self.value(f"{frames}.then(() => new Promise(r => setTimeout(r, {idle})))")

    def _call(self, method: str, **params: Any) -> dict[str, Any]:
        """The result of a method of the protocol."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result
            self._noted(answer)

    def _next(self) -> dict[str, Any]:
        """The next message of the browser."""
        while b"\0" not in self._rest:
            piece = os.read(self._in, 1 << 16)
            assert piece, "the browser ended"
            self._rest += piece
        text, self._rest = self._rest.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        return message

    def _noted(self, event: dict[str, Any]) -> None:
        """Keep what the console said and what was requested."""
        method, params = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.console.append(str(params["exceptionDetails"]))
        if method == "Runtime.consoleAPICalled":
            self.console.append(str(params["args"]))
        if method == "Log.entryAdded":
            self.console.append(params["entry"]["text"])
        if method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
