"""A headless Chromium driven through its DevTools pipe, with nothing but the standard library: load
a page, look at it, move the mouse, press keys, read what it complained about.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
_SETTINGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--hide-scrollbars",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--remote-debugging-pipe",
    "--force-color-profile=srgb",
)
_PATIENCE_S = 300.0  # before a test that would never end is given up; nothing is judged by it
#: the browser reads its commands from file 3 and answers into file 4
_LAUNCH = (
    "import fcntl, os, sys; pipes = [fcntl.fcntl(int(one), fcntl.F_DUPFD, 10) for one in "
    "sys.argv[1:3]]; [os.dup2(one, k) for k, one in enumerate(pipes, start=3)]; "
    "os.execvp(sys.argv[3], sys.argv[3:])"
)


@dataclass
class Page:
    """One tab. complaints: console errors and warnings, exceptions, refusals; requested: every
    address it asked for."""

    browser: Browser
    session: str
    complaints: list[str] = field(default_factory=list)
    requested: list[str] = field(default_factory=list)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        return self.browser.call(method, self.session, **parameters)

    def open(self, path: Path) -> None:
        """Load a file and wait until it has been parsed and its plots say that they are ready."""
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.wait("document.readyState === 'complete'")
        self.wait("'pamidReady' in window || !document.getElementById('samples')")

    def evaluate(self, expression: str) -> Any:
        """The value of an expression in the page (a promise is awaited); AssertionError where it
        throws."""
        told = self.call(
            "Runtime.evaluate",
            expression=expression,
            awaitPromise=True,
            returnByValue=True,
            userGesture=True,
        )
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def wait(self, expression: str, seconds: float = _PATIENCE_S) -> None:
        """Until the expression holds; AssertionError when it never does."""
        end = time.monotonic() + seconds
        while not self.evaluate(expression):
            assert time.monotonic() < end, (
                f"never became true: {expression}; the page said {self.complaints}"
            )
            time.sleep(0.02)

    def settle(self) -> None:
        """Until nothing scrolls or changes its height any more."""
        self.evaluate(
            "new Promise(done => { let last = '', same = 0; const look = () => {const now = "
            "[scrollX, scrollY, document.documentElement.scrollHeight].join();same = now === last "
            "? same + 1 : 0; last = now; same > 5 ? done() : setTimeout(look, 30); };look(); })"
        )

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """kind: mouseMoved, mousePressed, mouseReleased, mouseWheel; x, y in the viewport, CSS
        pixels."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, x: float, y: float, to_x: float) -> None:
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
        for k in range(1, 6):
            self.mouse("mouseMoved", x + (to_x - x) * k / 5, y, button="left", buttons=1)
        self.mouse("mouseReleased", to_x, y, button="left", clickCount=1)

    def key(self, key: str) -> None:
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def screenshot(self, path: Path, whole: bool = True) -> None:
        """A PNG of the whole page, or of what the window shows."""
        told = self.call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(told["data"]))

    def pdf(self, path: Path) -> None:
        """The page as it would be printed on A4."""
        told = self.call(
            "Page.printToPDF", paperWidth=8.27, paperHeight=11.69, preferCSSPageSize=True
        )
        path.write_bytes(base64.b64decode(told["data"]))

    def note(self, method: str, told: dict[str, Any]) -> None:
        if method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning", "assert"):
            self.complaints.append(
                " ".join(str(one.get("value", one.get("description"))) for one in told["args"])
            )
        elif method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.complaints.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Log.entryAdded":
            self.complaints.append(told["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requested.append(told["request"]["url"])


class Browser:
    """One process; `call` speaks its protocol, and hands every event that arrives meanwhile to its
    page."""

    def __init__(self, home: Path) -> None:
        assert CHROMIUM is not None
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-c",
                _LAUNCH,
                str(to_read),
                str(to_write),
                CHROMIUM,
                *_SETTINGS,
                f"--user-data-dir={home}",
            ],
            pass_fds=(to_read, to_write),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self._pages: dict[str, Page] = {}
        self._rest, self._count = b"", 0

    def call(self, method: str, session: str = "", **parameters: Any) -> dict[str, Any]:
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        os.write(
            self._write,
            json.dumps(message | ({"sessionId": session} if session else {})).encode() + b"\0",
        )
        while True:
            told = self._next()
            if told.get("id") == self._count:
                assert "error" not in told, (method, told["error"])
                return dict(told["result"])
            if told.get("sessionId") in self._pages:
                self._pages[told["sessionId"]].note(told["method"], told["params"])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            assert select.select([self._read], [], [], _PATIENCE_S)[0], (
                "the browser does not answer"
            )
            more = os.read(self._read, 1 << 20)
            assert more, "the browser has ended"
            self._rest += more
        one, _, self._rest = self._rest.partition(b"\0")
        return dict(json.loads(one))

    def page(
        self,
        width: int = 1280,
        height: int = 900,
        *,
        dark: bool = False,
        scripts: bool = True,
        offline: bool = True,
        print_: bool = False,
    ) -> Page:
        """An empty tab of this size, with the colours and the medium that its system asks for."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = self._pages[session] = Page(self, session)
        for domain in ("Page", "Runtime", "Log", "Network"):
            page.call(f"{domain}.enable")
        page.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        page.call("Emulation.setEmulatedMedia", media="print" if print_ else "", features=[scheme])
        page.call("Emulation.setScriptExecutionDisabled", value=not scripts)
        page.call(
            "Network.emulateNetworkConditions",
            offline=offline,
            latency=0,
            downloadThroughput=-1,
            uploadThroughput=-1,
        )
        return page

    def close(self) -> None:
        with suppress(AssertionError, OSError):
            self.call("Browser.close")
        os.close(self._write)
        os.close(self._read)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@contextmanager
def browser() -> Iterator[Browser]:
    """A browser with an empty home that is removed when it has ended."""
    with tempfile.TemporaryDirectory(prefix="pamid-browser-", ignore_cleanup_errors=True) as home:
        opened = Browser(Path(home))
        try:
            yield opened
        finally:
            opened.close()
