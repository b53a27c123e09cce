"""A headless Chromium over the W3C WebDriver protocol: a page opened, looked at, asked and
clicked.
"""

from __future__ import annotations

import base64
import json
import shutil
import socket
import subprocess
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

from tests.support.processes import end
from tests.support.world import until

ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--window-size=1240,1400",
)


def missing() -> str:
    """Why there is no browser here, or nothing."""
    absent = [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]
    return (
        f"{' and '.join(absent)} not installed (apt-get install chromium chromium-driver)"
        if absent
        else ""
    )


class Browser:
    """A context."""

    def __init__(self, profile: Path, *arguments: str) -> None:
        """arguments: of Chromium, more than ARGUMENTS."""
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        self._base = f"http://127.0.0.1:{port}"
        quiet = subprocess.DEVNULL
        command = ["chromedriver", f"--port={port}"]
        self._driver = subprocess.Popen(command, stdout=quiet, stderr=quiet)
        self._session = ""
        options = {
            "binary": shutil.which("chromium"),
            "args": [*ARGUMENTS, *arguments, f"--user-data-dir={profile}"],
        }
        wanted = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": options}}}

        def session() -> str:
            assert self._driver.poll() is None, "chromedriver does not start"
            try:
                return str(self._call("POST", "/session", wanted)["sessionId"])
            except urllib.error.HTTPError as error:
                raise AssertionError(error.read().decode()) from None
            except (urllib.error.URLError, ConnectionError):
                return ""

        self._session = f"/session/{until(session, 'answer of chromedriver', 30)}"

    def _call(self, method: str, path: str, body: Any = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self._base + path, data, {"Content-Type": "application/json"}, method=method
        )
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)["value"]

    def open(self, url: str) -> None:
        self._call("POST", f"{self._session}/url", {"url": url})

    def ask(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        return self._call(
            "POST", f"{self._session}/execute/sync", {"script": f"return {script};", "args": []}
        )

    def until(self, condition: str, timeout_s: float = 30) -> None:
        """Waits until a JavaScript expression is true."""
        until(lambda: self.ask(condition), condition, timeout_s)

    def click(self, selector: str) -> None:
        found = self._call(
            "POST", f"{self._session}/element", {"using": "css selector", "value": selector}
        )
        self._call("POST", f"{self._session}/element/{found[ELEMENT]}/click", {})

    def show_as(self, width_px: int, dark: bool) -> None:
        """Shows pages as on a screen of that width, in the reader's light or dark mode."""
        size = {"width": width_px, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        for command, values in (
            ("setDeviceMetricsOverride", size),
            ("setEmulatedMedia", {"features": scheme}),
        ):
            self._call(
                "POST",
                f"{self._session}/goog/cdp/execute",
                {"cmd": f"Emulation.{command}", "params": values},
            )

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self._call("GET", f"{self._session}/screenshot")))

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *error: object) -> None:
        try:
            if self._session:
                self._call("DELETE", self._session)
        finally:
            end(self._driver)
