"""A headless Chromium for tests, driven over a pair of pipes in the words of its DevTools protocol.

Pipes instead of a port need no client library: a message is JSON and a zero byte.
"""

import base64
import contextlib
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path

import cv2
import numpy as np

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
MISSING = "no Chromium here; to run the tests of the page install one: apt-get install chromium"
_MODIFIERS = {"Alt": 1, "Ctrl": 2, "Shift": 8}
# As root there is no sandbox; without a wider network nothing may be looked up.
_FLAGS = (
    "headless no-sandbox disable-gpu disable-quic no-first-run disable-sync disable-extensions hide-scrollbars "
    "disable-background-networking disable-component-update disable-dev-shm-usage force-color-profile=srgb "
    "remote-debugging-pipe"
)


def find_browser():
    return next((path for path in map(shutil.which, NAMES) if path), None) if os.name == "posix" else None


class PageError(AssertionError):
    """The page or the browser reported an error."""


class Browser:
    """One page in a browser of its own."""

    def __init__(self, folder: Path) -> None:
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        # The browser reads file 3 and writes file 4.
        command = f'exec "$@" 3</dev/fd/{to_browser} 4>/dev/fd/{from_browser}'
        options = [*(f"--{flag}" for flag in _FLAGS.split()), f"--user-data-dir={folder}", "about:blank"]
        command = ["/bin/sh", "-c", command, "sh", find_browser(), *options]
        nothing = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        self._process = subprocess.Popen(command, pass_fds=(to_browser, from_browser), **nothing)
        os.close(to_browser)
        os.close(from_browser)
        self._number, self._session, self._buffer = 0, None, b""
        self.errors: list[str] = []
        self.questions: list[str] = []
        targets = self.send("Target.getTargets")["targetInfos"]
        target = next(info["targetId"] for info in targets if info["type"] == "page")
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def resize(self, width: int, height: int, ratio: float = 1) -> None:
        """Give the window a size, CSS pixels, and so many pixels of the screen for each of them."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": False}
        self.send("Emulation.setDeviceMetricsOverride", **metrics)
        self.ratio = ratio

    def close(self) -> None:
        with contextlib.suppress(OSError, PageError):
            self._session = None
            self.send("Browser.close")
        for file in (self._write, self._read):
            os.close(file)
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def send(self, method: str, **params):
        number = self._post(method, **params)
        while True:
            answer = self._next()
            if answer.get("id") == number:
                if "error" in answer:
                    raise PageError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._note(answer)

    def _post(self, method: str, **params) -> int:
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        return self._number

    def _next(self):
        end = time.monotonic() + 30
        while b"\0" not in self._buffer:
            if not select.select([self._read], [], [], max(0, end - time.monotonic()))[0]:
                raise PageError("the browser says nothing for 30 s")
            more = os.read(self._read, 1 << 20)
            if not more:
                raise PageError("the browser ended")
            self._buffer += more
        line, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(line)

    def _note(self, event) -> None:
        """Keep what went wrong in the page, and answer its questions on leaving with yes."""
        params = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif event.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])
        elif event.get("method") == "Page.javascriptDialogOpening":
            self.questions.append(params["type"])
            self._post("Page.handleJavaScriptDialog", accept=True)

    def open(self, url: str, ready: str) -> None:
        """Load a page and wait until a JavaScript expression is true."""
        self.send("Page.navigate", url=url)
        self.wait(ready)

    def run(self, expression: str):
        answer = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise PageError(answer["exceptionDetails"]["exception"]["description"])
        return answer["result"].get("value")

    def wait(self, expression: str, seconds: float = 15) -> None:
        end = time.monotonic() + seconds
        while not self.run(expression):
            if time.monotonic() > end:
                raise PageError(f"not true after {seconds} s: {expression}; errors: {self.errors}")
            time.sleep(0.03)

    def text(self, selector: str) -> str:
        return self.run(f"document.querySelector({json.dumps(selector)}).textContent.trim()")

    def settle(self) -> None:
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def mouse(self, kind: str, x: float, y: float, **params) -> None:
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **params)

    def move(self, x: float, y: float) -> None:
        self.mouse("mouseMoved", x, y)

    def click(self, x: float, y: float) -> None:
        self.drag((x, y), (x, y))

    def drag(self, start, end, button: str = "left") -> None:
        self.move(*start)
        self.mouse("mousePressed", *start, button=button, clickCount=1)
        if start != end:
            middle = [(p + q) / 2 for p, q in zip(start, end, strict=True)]
            for place in (middle, end):
                self.mouse("mouseMoved", *place, button=button, buttons=1)
        self.mouse("mouseReleased", *end, button=button, clickCount=1)

    def wheel(self, x: float, y: float, delta: float) -> None:
        """Turn the wheel; below zero, away from the hand."""
        self.move(x, y)
        self.mouse("mouseWheel", x, y, deltaX=0, deltaY=delta)
        self.settle()

    def press(self, selector: str) -> None:
        box = f"document.querySelector({json.dumps(selector)}).getBoundingClientRect()"
        self.click(*self.run(f"(box => [box.x + box.width / 2, box.y + box.height / 2])({box})"))

    def key(self, key: str, *modifiers: str) -> None:
        held = sum(_MODIFIERS[name] for name in modifiers)
        for kind in ("rawKeyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=key, modifiers=held)

    def screenshot(self, part: tuple[float, float, float, float]):
        """Return what a part of the window (left, top, width, height) shows: RGB, pixels of the screen."""
        self.settle()
        clip = dict(zip(("x", "y", "width", "height", "scale"), (*part, 1), strict=True))
        data = base64.b64decode(self.send("Page.captureScreenshot", format="png", clip=clip)["data"])
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
