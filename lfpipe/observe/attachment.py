"""The page server's attachment to a session: status table, two picture rings, tap. Everything is released without viewers."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import zmq
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.observe.meter import Reading
from lfpipe.observe.session_commands import AsyncSessionCommands
from lfpipe.observe.session_reader import FollowingReader
from lfpipe.render.geometry import depth_range_px, depth_step_px
from lfpipe.render.view_grid import EyesOnGrid, draw_over_eyes
from lfpipe.transport import control, ring
from lfpipe.transport.clock import SECOND_NS, now_ns

LEASE_S = 5.0
LARGEST_PX = 1024  # longer side of a picture on the page
CAMERA_PX = 320
FULL_CHROMA = (cv2.IMWRITE_JPEG_QUALITY, 85, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)


class JpegReader:
    """The newest picture of one ring as JPEG with full chroma resolution: the chroma of an anaglyph separates the eyes."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._reader = ring.Reader(name)
        self._reader.last_seq = max(0, self._reader.published - 1)  # the current picture counts as new
        self._frame: NDArray[np.uint8] = np.empty(self._reader.shape, np.uint8)
        self.jpeg: bytes | None = None

    def jpeg_of_newest(self, largest_px: int, eyes: EyesOnGrid | None) -> bytes | None:
        """JPEG of the newest picture, at most largest_px wide or high; None before the first."""
        if self._reader.read(self._frame) is not None:
            scale = min(1.0, largest_px / max(self._frame.shape))
            shown = self._frame
            if scale < 1:
                small = cv2.resize(self._frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
                shown = small.astype(np.uint8, copy=False)
            if eyes is not None:
                draw_over_eyes(shown, eyes, scale)
            self.jpeg = cv2.imencode(".jpg", shown, FULL_CHROMA)[1].tobytes()
        return self.jpeg

    def close(self) -> None:
        """Releases the ring."""
        self._reader.close()


class Attachment:
    """Belongs to one event loop."""

    def __init__(self, name: str) -> None:
        self._follower, self._remote = FollowingReader(name), AsyncSessionCommands(name)
        self._zmq = control.context()
        self._tap: zmq.Socket[bytes] | None = None
        self._camera: JpegReader | None = None
        self._picture: JpegReader | None = None
        self._lease_end_ns = 0
        self._hello: dict[str, Any] = {}
        self._rev = -1
        self.eyes_on_grid: EyesOnGrid | None = None

    async def read(self) -> Reading | None:
        """The current session, None if there is none."""
        before = self._follower.watch
        reading = self._follower.read()
        if self._follower.watch is not before:
            self._let_go()
        if reading is None:
            return None
        if reading.config_rev != self._rev:
            try:
                self._hello, self._rev = await self._remote.ask({"cmd": "hello"}, 0.5), reading.config_rev
            except UserError:
                self._hello = {}
        self._hear()
        return reading

    def settings(self) -> dict[str, Any]:
        """The session's `config` and `paused`; `depth_px`: smallest and largest zero plane to offer, and step; `playlist`: names
        of scenes; `playlist_at`. Empty if the session did not answer."""
        found: dict[str, Any] = {key: self._hello[key] for key in ("config", "paused") if key in self._hello}
        if scene := self._hello.get("options", {}).get("scene"):
            low_px, high_px = scene["disparity_min_px"], scene["disparity_max_px"]
            names = [Path(path).name for path in self._hello["options"]["playlist"]]
            found["playlist"], found["playlist_at"] = names, self._hello["options"]["playlist_at"]
            found["depth_px"] = [*depth_range_px(low_px, high_px), depth_step_px(low_px, high_px)]
        return found

    def _hear(self) -> None:
        if self._follower.watch is None:
            return
        if self._tap is None:
            self._tap = self._zmq.socket(zmq.SUB)
            self._tap.setsockopt(zmq.RCVHWM, 100)
            self._tap.setsockopt(zmq.SUBSCRIBE, b"")
            control.connect(self._tap, self._follower.watch.session.run_dir, "tap")
        heard = []
        while self._tap.poll(0):
            heard.append(self._tap.recv())
        for data in reversed(heard):  # the newest message is enough
            try:
                message = control.decode(data)
                if message.get("topic") == "look":
                    self.eyes_on_grid = EyesOnGrid.of(message)
                    return
            except (control.BadMessage, KeyError, TypeError, ValueError):
                continue  # another version: ignored

    def camera(self) -> bytes | None:
        """The camera picture with the grid of views over the eyes, JPEG."""
        if self._follower.watch is None:
            return None
        if self._camera is None:
            self._camera = JpegReader(self._follower.watch.session.segment("frames"))
        return self._camera.jpeg_of_newest(CAMERA_PX, self.eyes_on_grid)

    async def picture(self) -> bytes | None:
        """The picture on the screen, JPEG. Requests the ring from the session and renews the lease. Not reentrant."""
        watch = self._follower.watch
        if watch is None:
            return None
        if now_ns() > self._lease_end_ns - LEASE_S / 2 * SECOND_NS:
            part = str((await self._remote.ask({"cmd": "pictures", "lease_s": LEASE_S}))["ring"])
            if self._follower.watch is not watch:  # the session ended meanwhile
                return None
            self._lease_end_ns = now_ns() + int(LEASE_S * SECOND_NS)
            name = watch.session.segment(part)
            if self._picture is None or self._picture.name != name:
                old, self._picture = self._picture, None
                if old is not None:
                    old.close()
                self._picture = JpegReader(name)
        return self._picture.jpeg_of_newest(LARGEST_PX, None) if self._picture else None

    def reset(self) -> None:
        """Resets the histograms."""
        if self._follower.watch is not None:
            self._follower.watch.meter.reset()

    def _let_go(self) -> None:
        for eyepiece in (self._camera, self._picture):
            if eyepiece is not None:
                eyepiece.close()
        if self._tap is not None:
            self._tap.close()
        self._camera = self._picture = self._tap = self.eyes_on_grid = None
        self._lease_end_ns, self._rev, self._hello = 0, -1, {}

    def rest(self) -> None:
        """Releases everything; called when there are no viewers."""
        self._let_go()
        self._follower.close()

    def close(self) -> None:
        """Ends the attachment."""
        self.rest()
        self._remote.close()
        self._zmq.term()
