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

import attrs
import cv2
import numpy as np
import zmq
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.observe.session_commands import SessionCommands
from lfpipe.observe.session_reader import FollowingReader
from lfpipe.observe.state_text import photon_words, spans
from lfpipe.render.geometry import depth_range_px, depth_step_px
from lfpipe.render.view_grid import EyesOnGrid, draw_over_eyes
from lfpipe.transport import control, ring
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.histogram import MIDDLES_US

PERIOD_S = 0.25
COMMAND_S, LOAD_S = 2.0, 20.0  # timeouts of answers; packing a scene may take longer
MAX_WAITING = 8  # commands of one page
IDLE_S = 3.0
LEASE_S = 5.0  # of the ring of pictures
PICTURES = {"camera": 320, "picture": 1024}  # px of the longer side on the page
PICTURE_S = 0.2  # less than PERIOD_S: each sample has a new picture
RETRY_NS = SECOND_NS  # after no picture was available
EDGES_MS = np.geomspace(0.05, 100.0, 34)  # of the page's histograms; the outer bins hold everything below and above
_BIN = np.clip(np.searchsorted(EDGES_MS, MIDDLES_US / 1e3) - 1, 0, len(EDGES_MS) - 2)
# full chroma resolution: the chroma of an anaglyph separates the eyes
FULL_CHROMA = (cv2.IMWRITE_JPEG_QUALITY, 85, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)

log = logging.getLogger(__name__)


def binned(counts: NDArray[np.int64]) -> list[int]:
    """A histogram on MIDDLES_US as counts between EDGES_MS."""
    bins: list[int] = np.bincount(_BIN, counts, len(EDGES_MS) - 1).astype(np.int64).tolist()
    return bins


def page_message(state: dict[str, Any] | None, settings: dict[str, Any]) -> dict[str, Any]:
    """The message for the page: the state of `Watch.read_window` with histograms in bins, and the session's settings."""
    if state is None:
        return {"alive": False}
    stages = {
        name: {**stage, "cpus": spans(stage["cpus"]), "busy_counts": binned(stage["busy_counts"])}
        for name, stage in state["stages"].items()
        if stage["state"] != "NONE"
    }
    edges_ms = [round(float(edge), 3) for edge in EDGES_MS]
    photon = photon_words(state["motion_to_photon"])
    return {"alive": True, **state, "motion_to_photon": photon, "stages": stages, "edges_ms": edges_ms, **settings}


class JpegReader:
    """The newest picture of one ring as JPEG."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._reader = ring.Reader(name)
        self._reader.last_seq = max(0, self._reader.published - 1)  # the current picture counts as new
        self._frame: NDArray[np.uint8] = np.empty(self._reader.shape, np.uint8)
        self._jpeg: bytes | None = None

    def jpeg_of_newest(self, largest_px: int, eyes: EyesOnGrid | None) -> bytes | None:
        """JPEG of the newest picture, at most largest_px wide or high, with the grid over the eyes; None before the first."""
        if self._reader.read(self._frame) is not None:
            scale, picture = min(1.0, largest_px / max(self._frame.shape)), self._frame
            if scale < 1:
                small = cv2.resize(self._frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
                picture = small.astype(np.uint8, copy=False)
            if eyes is not None:
                draw_over_eyes(picture, eyes, scale)
            self._jpeg = cv2.imencode(".jpg", picture, FULL_CHROMA)[1].tobytes()
        return self._jpeg

    def close(self) -> None:
        """Releases the ring."""
        self._reader.close()


@attrs.define
class _CachedJpeg:
    """A picture shared by all viewers."""

    jpeg: bytes | None = None
    made_ns: int = 0
    lock: asyncio.Lock = attrs.field(factory=asyncio.Lock)


class Feed:
    """Belongs to one event loop. Releases the session IDLE_S after the last call. Commands are sent by one thread, in order."""

    def __init__(self, name: str) -> None:
        self.viewers = 0
        self._picture_viewers = 0
        self._follower, self._commands = FollowingReader(name), SessionCommands(name)
        self._thread, self._waiting = ThreadPoolExecutor(1, "lfpipe-ctl"), 0
        self._zmq = control.context()
        self._tap: zmq.Socket[bytes] | None = None
        self._readers: dict[str, JpegReader] = {}
        self._lease_end_ns = 0
        self._hello: dict[str, Any] = {}
        self._revision = -1
        self._eyes: EyesOnGrid | None = None
        self._jpegs = {which: _CachedJpeg() for which in PICTURES}
        self._sampler: asyncio.Task[None] | None = None
        self._wake, self._touched_ns, self._ended = asyncio.Event(), 0, False
        self._next: asyncio.Future[tuple[bytes, bytes]] | None = None  # the next sample: figures, pictures

    async def events(self, pictures: bool) -> AsyncGenerator[bytes]:
        """Yields the newest sample as server-sent events until the feed ends: figures as JSON, pictures as JPEG in base64."""
        self.viewers += 1
        self._picture_viewers += pictures
        try:
            while not self._ended:
                self._touch()
                if self._next is None:
                    self._next = asyncio.get_running_loop().create_future()
                figures, jpegs = await asyncio.shield(self._next)
                if figures:
                    yield figures + jpegs if pictures else figures
        finally:
            self.viewers -= 1
            self._picture_viewers -= pictures

    async def picture(self, which: str) -> bytes | None:
        """JPEG of one of PICTURES, at most PICTURE_S old; None if there is none."""
        self._touch()
        cached = self._jpegs[which]
        async with cached.lock:
            if now_ns() - cached.made_ns > PICTURE_S * SECOND_NS and not self._ended:
                try:
                    cached.jpeg = await self._newest_jpeg(which)
                except (UserError, FileNotFoundError, ValueError):  # the session has just ended
                    cached.jpeg = None
                cached.made_ns = now_ns() + (0 if cached.jpeg else RETRY_NS)
            return cached.jpeg

    async def command(self, message: dict[str, Any]) -> dict[str, Any]:
        """Returns the session's answer. Raises UserError as ctl does, or if MAX_WAITING commands wait."""
        return await self._ask(message, LOAD_S if message["cmd"] == "load" else COMMAND_S)

    def reset(self) -> None:
        """Resets the histograms."""
        self._touch()
        self._follower.reset()

    async def end(self) -> None:
        """Ends the streams and releases everything."""
        self._ended = True
        self._wake.set()
        if self._sampler is not None:
            await self._sampler
        self._release()
        self._follower.close()
        self._thread.shutdown(cancel_futures=True)
        self._zmq.term()

    async def _ask(self, message: dict[str, Any], timeout_s: float = COMMAND_S) -> dict[str, Any]:
        if self._waiting >= MAX_WAITING:
            raise UserError("the monitor is busy with other commands", "try again in a second")
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, self._commands.ask, message, timeout_s)
        finally:
            self._waiting -= 1

    def _touch(self) -> None:
        self._touched_ns = now_ns()
        self._wake.set()
        if self._sampler is None and not self._ended:
            self._sampler = asyncio.create_task(self._sample())

    async def _sample(self) -> None:
        while not self._ended:
            try:
                if not self.viewers and now_ns() - self._touched_ns > IDLE_S * SECOND_NS:
                    self._wake.clear()
                    self._release()
                    self._follower.close()
                    await self._wake.wait()
                    continue
                state = await self._state()
                message = page_message(state, self._settings())
                jpegs = [await self._event(which) for which in PICTURES if self._picture_viewers]
            except Exception:  # a defect, or a half-removed session: viewers see "no session"
                log.exception("no sample of the session")
                message, jpegs = page_message(None, {}), []
            self._publish(f"data: {json.dumps(message)}\n\n".encode(), b"".join(jpegs))
            await asyncio.sleep(PERIOD_S)
        self._publish(b"", b"")

    async def _event(self, which: str) -> bytes:
        jpeg = await self.picture(which)
        return b"event: %s\ndata: %s\n\n" % (which.encode(), base64.b64encode(jpeg)) if jpeg else b""

    def _publish(self, figures: bytes, jpegs: bytes) -> None:
        waiting, self._next = self._next, None
        if waiting is not None:
            waiting.set_result((figures, jpegs))

    async def _state(self) -> dict[str, Any] | None:
        """The current session, None if there is none."""
        before = self._follower.watch
        state = self._follower.read()
        if self._follower.watch is not before:
            self._release()
        if state is None:
            return None
        if state["config_rev"] != self._revision:
            try:
                self._hello, self._revision = await self._ask({"cmd": "hello"}, 0.5), state["config_rev"]
            except UserError:
                self._hello = {}
        self._read_tap()
        return state

    def _settings(self) -> dict[str, Any]:
        """The session's `config` and `paused`; `depth_px`: smallest and largest zero plane to offer, and step; `playlist`: names
        of scenes; `playlist_at`. Empty if the session did not answer."""
        settings: dict[str, Any] = {key: self._hello[key] for key in ("config", "paused") if key in self._hello}
        options = self._hello.get("options", {})
        if scene := options.get("scene"):
            low_px, high_px = scene["disparity_min_px"], scene["disparity_max_px"]
            settings["playlist"] = [Path(path).name for path in options["playlist"]]
            settings["playlist_at"] = options["playlist_at"]
            settings["depth_px"] = [*depth_range_px(low_px, high_px), depth_step_px(low_px, high_px)]
        return settings

    def _read_tap(self) -> None:
        """Keeps the newest position of the eyes on the grid."""
        if self._follower.watch is None:
            return
        if self._tap is None:
            self._tap = self._zmq.socket(zmq.SUB)
            self._tap.setsockopt(zmq.RCVHWM, 100)
            self._tap.setsockopt(zmq.SUBSCRIBE, b"")
            control.connect(self._tap, self._follower.watch.session.run_dir, "tap")
        while self._tap.poll(0):
            try:
                message = control.decode(self._tap.recv())
                if message.get("topic") == "look":
                    self._eyes = EyesOnGrid.of(message)
            except (control.BadMessage, KeyError, TypeError, ValueError):
                continue  # another version: ignored

    async def _newest_jpeg(self, which: str) -> bytes | None:
        """The camera's picture with the grid of views over the eyes, or the picture on the screen. Not reentrant."""
        watch = self._follower.watch
        if watch is None:
            return None
        if which == "camera":
            name = watch.session.segment("frames")
        elif now_ns() > self._lease_end_ns - LEASE_S / 2 * SECOND_NS:
            answer = await self._ask({"cmd": "pictures", "lease_s": LEASE_S})
            if self._follower.watch is not watch:  # the session ended meanwhile
                return None
            self._lease_end_ns = now_ns() + int(LEASE_S * SECOND_NS)
            name = watch.session.segment(str(answer["ring"]))
        elif which in self._readers:
            name = self._readers[which].name
        else:
            return None
        if which not in self._readers or self._readers[which].name != name:
            if (old := self._readers.pop(which, None)) is not None:
                old.close()
            self._readers[which] = JpegReader(name)
        return self._readers[which].jpeg_of_newest(PICTURES[which], self._eyes if which == "camera" else None)

    def _release(self) -> None:
        for reader in self._readers.values():
            reader.close()
        self._readers.clear()
        if self._tap is not None:
            self._tap.close()
        self._tap = self._eyes = None
        self._lease_end_ns, self._revision, self._hello = 0, -1, {}
