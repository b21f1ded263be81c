"""A headless Chromium, driven by its own DevTools protocol over a pipe: no package, no port, no web socket."""

from __future__ import annotations

import base64
import json
import os
import queue
import shutil
import subprocess
import threading
from pathlib import Path
from types import TracebackType
from typing import Any

from helpers.waiting import PATIENCE_S

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = """
    --headless --no-sandbox --disable-gpu --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic
    --no-first-run --disable-background-networking --disable-component-update --disable-sync --disable-dev-shm-usage
    --hide-scrollbars --remote-debugging-pipe
"""


def executable() -> str | None:
    """Where Chromium is, if it is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Chromium:
    """One page. `messages` has what its console said and what it failed to load."""

    def __init__(self, profile: Path, *, width: int = 1280, height: int = 800) -> None:
        """Start it, with an empty profile."""
        read, self._write = os.pipe()
        self._read, write = os.pipe()
        # The protocol speaks on file descriptors 3 and 4, whatever these pipes have got.
        shell = f'exec "$@" 3<&{read} 4>&{write}'
        flags = [*FLAGS.split(), f"--user-data-dir={profile}", f"--window-size={width},{height}"]
        self._process = subprocess.Popen(
            ["bash", "-c", shell, "bash", str(executable()), *flags, "about:blank"],
            pass_fds=(read, write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(read)
        os.close(write)
        self.messages: list[str] = []
        self._number = 0
        self._answers: queue.Queue[dict[str, Any] | None] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()
        self._session = ""
        page = next(t for t in self._send("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = self._send("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._send(f"{domain}.enable")
        self.resize(width, height)

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self._process.terminate()
        self._process.wait(PATIENCE_S)
        os.close(self._write)

    def resize(self, width: int, height: int) -> None:
        """Give the window this size, in CSS pixels."""
        self._send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def navigate(self, url: str) -> None:
        """Go there."""
        self._send("Page.navigate", url=url)

    def type(self, text: str) -> None:
        """Put text where the cursor is, as from a keyboard."""
        self._send("Input.insertText", text=text)
        self._send("Input.dispatchKeyEvent", type="keyUp", key=text[-1])

    def open(self, url: str) -> None:
        """Go there and wait until the viewer has drawn, or says why not."""
        self.navigate(url)
        self.until("(viewer && viewer.matrix) || !document.getElementById('error').hidden")

    def leave(self) -> None:
        """Go to an empty page, and forget what the one before said."""
        self._send("Page.navigate", url="about:blank")
        self.until("location.href == 'about:blank'")
        self.messages.clear()

    def value(self, script: str) -> Any:
        """What an expression is, promises awaited."""
        answer = self._send("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def enter(self, field: str, value: object, *, of: str = "value", event: str = "change") -> None:
        """Change a field, which a CSS selector finds, as a user does."""
        self.value(f"""(field => {{
            field.{of} = {json.dumps(value)};
            field.dispatchEvent(new Event('{event}'));
        }})(document.querySelector({json.dumps(field)}))""")

    def box(self, element: str) -> Any:
        """Left, top, width and height of what an expression is, in the window."""
        sides = "({left, top, width, height}) => [left, top, width, height]"
        return self.value(f"({sides})({element}.getBoundingClientRect())")

    def until(self, condition: str) -> None:
        """Wait for an expression that becomes true; what is not defined yet is not."""
        milliseconds = PATIENCE_S * 1e3
        waiting = f"""new Promise((done, failed) => {{
            const since = performance.now();
            const look = () => {{
                let is_so = false;
                try {{ is_so = {condition}; }} catch {{}}
                if (is_so) done(true);
                else if (performance.now() - since > {milliseconds}) failed(new Error("never"));
                else setTimeout(look, 20);
            }};
            look();
        }})"""
        assert self.value(waiting) is True

    def click(self, x: float, y: float, *, count: int = 1) -> None:
        """Press and release the left button there."""
        for kind in ("mousePressed", "mouseReleased"):
            self._send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=count)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag with the left button."""
        common = {"button": "left", "buttons": 1}
        self._send("Input.dispatchMouseEvent", type="mousePressed", x=start[0], y=start[1], clickCount=1, **common)
        self._send("Input.dispatchMouseEvent", type="mouseMoved", x=end[0], y=end[1], **common)
        self._send("Input.dispatchMouseEvent", type="mouseReleased", x=end[0], y=end[1], clickCount=1, **common)

    def store_in(self, folder: Path) -> None:
        """Put what a page gives to be saved into this folder; a file has its name when it is whole."""
        self._send("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))

    def screenshot(self, path: Path) -> None:
        """Screenshot as PNG."""
        path.write_bytes(base64.b64decode(self._send("Page.captureScreenshot", format="png")["data"]))

    def _send(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._answers.get(timeout=PATIENCE_S)
            assert answer is not None, f"{method}: Chromium has ended"
            if answer["id"] == self._number:
                assert "error" not in answer, (method, answer["error"])
                return dict(answer["result"])

    def _listen(self) -> None:
        held = b""
        while part := os.read(self._read, 1 << 16):
            *whole, held = (held + part).split(b"\0")
            for message in map(json.loads, whole):
                if "id" in message:
                    self._answers.put(message)
                else:
                    self._note(message)
        os.close(self._read)
        self._answers.put(None)

    def _note(self, event: dict[str, Any]) -> None:
        parameters = event["params"]
        if event["method"] == "Runtime.exceptionThrown":
            self.messages.append(str(parameters["exceptionDetails"]))
        elif event["method"] == "Log.entryAdded" and parameters["entry"]["level"] in ("warning", "error"):
            self.messages.append(parameters["entry"]["text"])
        elif event["method"] == "Runtime.consoleAPICalled" and parameters["type"] in ("warning", "error"):
            self.messages.append(str(parameters["args"]))
        elif event["method"] == "Network.requestWillBeSent":
            self.messages.append(f"request {parameters['request']['url'][:80]}")
