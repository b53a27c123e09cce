"""What the page shows: samples of a session's state and pictures, one sampler for any number of viewers.

It attaches to the status table, two picture rings and the tap while the page has viewers, and releases everything without.
"""

import asyncio
import base64
import json
import logging
from collections.abc import AsyncGenerator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import zmq
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.observe.session_commands import ask
from lfpipe.observe.session_reader import FollowingReader
from lfpipe.observe.state_text import photon_words
from lfpipe.render.geometry import zero_planes_px
from lfpipe.render.view_grid import EyesOnGrid, draw_over_eyes
from lfpipe.transport import control, ring
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.session import Session

PERIOD_S = 0.25
COMMAND_S, LOAD_S = 2.0, 20.0  # timeouts of answers; packing a scene may take longer
LEASE_S = 5.0  # of the ring of pictures
PICTURES = {"camera": 320, "picture": 1024}  # px of the longer side on the page
# full chroma resolution: the chroma of an anaglyph separates the eyes
FULL_CHROMA = (cv2.IMWRITE_JPEG_QUALITY, 85, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)

log = logging.getLogger(__name__)


def _settings(hello: dict[str, Any]) -> dict[str, Any]:
    """The session's `config` and `paused`; `depth_px`: smallest and largest zero plane to offer, and step; `playlist`: names
    of scenes; `playlist_at`. Empty if the session did not answer."""
    settings: dict[str, Any] = {key: hello[key] for key in ("config", "paused") if key in hello}
    options = hello.get("options", {})
    if scene := options.get("scene"):
        low_px, high_px = scene["disparity_min_px"], scene["disparity_max_px"]
        settings["playlist"] = [Path(path).name for path in options["playlist"]]
        settings["playlist_at"] = options["playlist_at"]
        settings["depth_px"] = zero_planes_px(low_px, high_px)
    return settings


class Pictures:
    """The pictures of one session as JPEG."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._readers: dict[str, ring.Reader] = {}
        self._jpegs: dict[str, bytes | None] = {}
        self._eyes: EyesOnGrid | None = None
        self._zmq = control.context()
        self._tap = self._zmq.socket(zmq.SUB)
        self._tap.setsockopt(zmq.RCVHWM, 100)
        self._tap.setsockopt(zmq.SUBSCRIBE, b"")
        control.connect(self._tap, session.run_dir, "tap")

    def newest(self, which: str, ring_name: str) -> bytes | None:
        """`camera`: with the grid of views over the eyes; `picture`: as on the screen. None before the first.

        Raises FileNotFoundError or ValueError if there is no such ring.
        """
        name, reader = self._session.segment(ring_name), self._readers.get(which)
        if reader is None or reader.name != name:
            if reader is not None:
                self._readers.pop(which).close()
            reader = self._readers[which] = ring.Reader(name)
            reader.last_seq = max(0, reader.published - 1)  # the current picture counts as new
            self._jpegs[which] = None
        frame: NDArray[np.uint8] = np.empty(reader.shape, np.uint8)
        if reader.read(frame) is not None:
            scale = min(1.0, PICTURES[which] / max(frame.shape))
            if scale < 1:
                frame = np.asarray(cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
            if which == "camera" and (eyes := self._seen_eyes()) is not None:
                draw_over_eyes(frame, eyes, scale)
            self._jpegs[which] = cv2.imencode(".jpg", frame, FULL_CHROMA)[1].tobytes()
        return self._jpegs[which]

    def _seen_eyes(self) -> EyesOnGrid | None:
        while self._tap.poll(0):
            try:
                message = control.decode(self._tap.recv())
                if message.get("topic") == "look":
                    self._eyes = EyesOnGrid.of(message)
            except (control.BadMessage, KeyError, TypeError, ValueError):
                continue  # another version: ignored
        return self._eyes

    def close(self) -> None:
        """Releases the rings and the tap."""
        for reader in self._readers.values():
            reader.close()
        self._tap.close()
        self._zmq.term()


class Feed:
    """Belongs to one event loop. Commands are sent by one thread, in order."""

    def __init__(self, name: str) -> None:
        self.name, self.viewers = name, 0
        self._follower = FollowingReader(name)
        self._thread = ThreadPoolExecutor(1, "lfpipe-ctl")
        self._pictures: Pictures | None = None
        self._lent, self._lease_end_ns = "", 0  # the ring of the picture on the screen
        self._hello: dict[str, Any] = {}
        self._revision = -1
        self._sampler: asyncio.Task[None] | None = None
        self._news, self._newest, self._ended = asyncio.Condition(), b"", False

    async def events(self) -> AsyncGenerator[bytes]:
        """Yields the newest sample as server-sent events until the feed ends: figures as JSON, pictures as JPEG in base64."""
        self.viewers += 1
        if self._sampler is None:
            self._sampler = asyncio.create_task(self._sample())
        try:
            while not self._ended:
                async with self._news:
                    await self._news.wait()
                yield self._newest
        finally:
            self.viewers -= 1

    async def command(self, message: dict[str, Any]) -> dict[str, Any]:
        """Returns the session's answer. `reset` counts drops and worst times from now on. Raises UserError."""
        if message["cmd"] == "reset":
            self._follower.reset()
            return {"ok": True}
        return await self._ask(message, LOAD_S if message["cmd"] == "load" else COMMAND_S)

    async def end(self) -> None:
        """Ends the streams and releases everything."""
        self._ended = True
        if self._sampler is not None:
            await self._sampler
        async with self._news:
            self._news.notify_all()
        self._thread.shutdown(cancel_futures=True)

    async def _ask(self, message: dict[str, Any], timeout_s: float = COMMAND_S) -> dict[str, Any]:
        return await asyncio.get_running_loop().run_in_executor(self._thread, ask, self.name, message, timeout_s)

    async def _sample(self) -> None:
        while self.viewers and not self._ended:
            try:
                figures = await self._figures()
                pictures = [await self._picture(which) for which in PICTURES]
            except Exception:  # a defect, or a half-removed session: viewers see "no session"
                log.exception("no sample of the session")
                figures, pictures = {"alive": False}, []
            self._newest = b"".join([f"data: {json.dumps(figures)}\n\n".encode(), *pictures])
            async with self._news:
                self._news.notify_all()
            await asyncio.sleep(PERIOD_S)
        self._release()
        self._follower.close()
        self._sampler = None

    async def _figures(self) -> dict[str, Any]:
        """The state of `Watch.read_window`, and the session's settings."""
        before, state = self._follower.watch, self._follower.read()
        if self._follower.watch is not before:
            self._release()
        if state is None or self._follower.watch is None:
            return {"alive": False}
        if self._pictures is None:
            self._pictures = Pictures(self._follower.watch.session)
        if state["config_rev"] != self._revision:
            try:
                self._hello, self._revision = await self._ask({"cmd": "hello"}, 0.5), state["config_rev"]
            except UserError:
                self._hello = {}
        stages = {name: stage for name, stage in state["stages"].items() if stage["state"] != "NONE"}
        photon = photon_words(state["motion_to_photon"])
        return {"alive": True, **state, "motion_to_photon": photon, "stages": stages, **_settings(self._hello)}

    async def _picture(self, which: str) -> bytes:
        """An event with the picture; empty if there is none."""
        if self._pictures is None:
            return b""
        try:
            if which == "picture" and now_ns() > self._lease_end_ns - LEASE_S / 2 * SECOND_NS:
                self._lent = str((await self._ask({"cmd": "pictures", "lease_s": LEASE_S}))["ring"])
                self._lease_end_ns = now_ns() + int(LEASE_S * SECOND_NS)
            jpeg = self._pictures.newest(which, "frames" if which == "camera" else self._lent)
        except (UserError, FileNotFoundError, ValueError):  # no camera, or the session has just ended
            return b""
        return b"event: %s\ndata: %s\n\n" % (which.encode(), base64.b64encode(jpeg)) if jpeg else b""

    def _release(self) -> None:
        if self._pictures is not None:
            self._pictures.close()
        self._pictures, self._lease_end_ns, self._revision, self._hello = None, 0, -1, {}
