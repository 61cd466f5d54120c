"""A headless Chromium that tests steer through a pipe (the DevTools protocol).

python -m tests.plots.browser PAGE.html PICTURE.png [WIDTH [HEIGHT]]   takes a picture of a page
"""

import base64
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--hide-scrollbars",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-pipe",
)
PATIENCE = 60.0  # seconds


class Browser:
    """One tab. ``errors`` collects what the console shows as errors, and uncaught exceptions."""

    def __init__(self, folder: Path) -> None:
        to_chromium, self._to = os.pipe()
        self._from, from_chromium = os.pipe()
        # Chromium reads from 3 and writes to 4.
        line = f'exec "$0" "$@" 3<&{to_chromium} 4>&{from_chromium}'
        self._process = subprocess.Popen(
            ["bash", "-c", line, CHROMIUM, *OPTIONS, f"--user-data-dir={folder}", "about:blank"],
            pass_fds=(to_chromium, from_chromium),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_chromium)
        os.close(from_chromium)
        self._number, self._session, self._unread = 0, None, b""
        self.errors, self.requests = [], []
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        attached = self._call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._session = None
        self._call("Browser.close")
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def _call(self, method, **parameters):
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]
            self._notice(answer.get("method"), answer.get("params", {}))

    def _read(self):
        while b"\0" not in self._unread:
            part = os.read(self._from, 1 << 20)
            assert part, "Chromium ended"
            self._unread += part
        message, _, self._unread = self._unread.partition(b"\0")
        return json.loads(message)

    def _notice(self, method, parameters):
        if method == "Runtime.exceptionThrown":
            self.errors.append(parameters["exceptionDetails"].get("exception", parameters))
        if method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(parameters["entry"]["text"])
        if method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert"):
            self.errors.append(parameters["args"])
        if method == "Page.loadEventFired":
            self._loaded = True
        if method == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])

    def open(self, page: Path, width: int, height: int = 900, ready: bool = True) -> None:
        """Show a page in a window of this size; if ``ready``, until its first picture is drawn."""
        self.errors.clear()
        self.requests.clear()
        self._call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip
        self._loaded = False
        self._call("Page.navigate", url=page.resolve().as_uri())
        while not self._loaded:
            answer = self._read()
            self._notice(answer.get("method"), answer.get("params", {}))
        end = time.monotonic() + PATIENCE
        while ready and self.run("document.documentElement.dataset.ready") != "yes":
            assert time.monotonic() < end, ("not ready", self.errors)
            time.sleep(0.05)

    def run(self, script: str):
        """The value of an expression; after it, what was asked to be drawn is drawn."""
        answer = self._call(
            "Runtime.evaluate",
            expression=f"(async () => {{ const value = {script};"
            "for (let i = 0; i < 3; i++) await new Promise(requestAnimationFrame);"
            "return value; })()",
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def picture(self, selector: str | None = None) -> np.ndarray:
        """[H, W, 3], of the first element or of the whole page."""
        data = self.screenshot(selector)
        with Image.open(io.BytesIO(data)) as image:
            return np.asarray(image.convert("RGB"))

    def screenshot(self, selector: str | None = None) -> bytes:
        box = self._box(selector or "html")
        clip = {**box, "scale": 1}
        answer = self._call("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        return base64.b64decode(answer["data"])

    def _box(self, selector):
        return self.run(
            f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect();"
            "return {x: b.x + scrollX, y: b.y + scrollY, width: b.width, height: b.height}; })()"
        )

    def drag(self, selector: str, right: int, down: int) -> None:
        """Press in the middle of an element, move, and release."""
        self.run(f"document.querySelector('{selector}').scrollIntoView({{block: 'center'}})")
        x, y = self.run(
            f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect();"
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        for kind, share, pressed in (
            ("mousePressed", 0.0, 1),
            ("mouseMoved", 0.5, 1),
            ("mouseMoved", 1.0, 1),
            ("mouseReleased", 1.0, 0),
        ):
            self._call(
                "Input.dispatchMouseEvent",
                type=kind, x=x + share * right, y=y + share * down, button="left",
                buttons=pressed, clickCount=1,
            )  # fmt: skip
        self.run("0")

    def press(self, key: str) -> None:
        """Press a key on what has the focus."""
        for kind in ("keyDown", "keyUp"):
            self._call("Input.dispatchKeyEvent", type=kind, key=key)
        self.run("0")


def _take_picture(page: str, picture: str, width: str = "1440", height: str = "") -> None:
    """Save the upper ``height`` pixels of a page, or the whole page."""
    with tempfile.TemporaryDirectory() as folder, Browser(Path(folder)) as browser:
        browser.open(Path(page), int(width))
        shown = browser.picture()
    image = Image.fromarray(shown[: int(height) if height else None])
    image.save(picture, optimize=True)


if __name__ == "__main__":
    _take_picture(*sys.argv[1:])
