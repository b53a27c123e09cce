"""The data of the page: samples of a session's state and pictures, one sampler for any number of
viewers.

It attaches to the status table, two picture rings and the tap only while the page has viewers.
"""

import asyncio
import base64
import itertools
import json
import logging
from collections.abc import AsyncGenerator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import zmq
from numpy.typing import NDArray

from lfpipe.config import converter
from lfpipe.config.session_options import MouseViewer
from lfpipe.errors import UserError
from lfpipe.monitor.monitor import PERIOD_S, photon_words
from lfpipe.monitor.session_reader import Follower, Sample
from lfpipe.render.synthesis.viewpoint import zero_planes_px
from lfpipe.supervisor.process_table import TRACKED_BY
from lfpipe.supervisor.rundir import ask
from lfpipe.transport import control, ring
from lfpipe.transport.control import Session
from lfpipe.transport.ring import SECOND_NS, now_ns

COMMAND_S, LOAD_S = 2.0, 20.0  # timeouts of answers; packing a scene may take longer
LEASE_S = 5.0  # of the ring of pictures: it is removed soon after the last viewer leaves
PICTURES = {"camera": 320, "picture": 1024}  # px of the longer side on the page
# full chroma resolution: the chroma of an anaglyph separates the eyes
FULL_CHROMA = (
    cv2.IMWRITE_JPEG_QUALITY,
    85,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
)
LEFT_BGR, RIGHT_BGR, GRID_BGR = (60, 60, 255), (255, 255, 60), (235, 235, 235)
_SHIFT = 4  # sub-pixel bits of OpenCV's drawing

log = logging.getLogger(__name__)


def metrics_of(state: Sample) -> dict[str, Any]:
    """The state for the page, without the options, which are not for every viewer.

    Adds `scene`: its name; `depth_inverted`; `depth_px`: smallest and largest zero plane to offer,
    and step; `playlist`: names of scenes; `playlist_at`; `mouse`: whether it is the viewer;
    `recording`.
    """
    metrics = state.metrics
    shown = metrics.to_dict()
    shown |= {
        "alive": True,
        "motion_to_photon": photon_words(metrics.motion_to_photon),
        "stages": {name: shown["stages"][name] for name in metrics.used_stages},
    }
    if (settings := state.settings) is None:
        return shown
    options = settings.options
    if not options.viewer.tracked:  # a camera that another viewer has replaced
        for name in ("capture", TRACKED_BY):
            shown["stages"].pop(name, None)
    shown |= {"config": converter().unstructure(settings.config), "paused": settings.paused}
    shown |= {"mouse": isinstance(options.viewer, MouseViewer), "recording": bool(options.record)}
    if (scene := options.scene) is not None:
        shown |= {
            "scene": scene.name,
            "depth_inverted": scene.depth_inverted,
            "playlist": [Path(path).name for path in options.playlist],
            "playlist_at": options.playlist_at,
            "depth_px": zero_planes_px(scene.disparity_min_px, scene.disparity_max_px),
        }
    return shown


def place_px(look: Mapping[str, Any], row: float, col: float) -> tuple[float, float]:
    """The eye position for a view, in px of the camera picture: the inverse of `ViewSolver.views`.
    look: render's message of that topic.
    """
    rows, cols = look["grid"]
    x, y = look["centre_px"]
    alpha_px = look["alpha_px"]
    return x - (col - (cols - 1) / 2) * alpha_px, y + (row - (rows - 1) / 2) * alpha_px


def draw_over_eyes(picture: NDArray[np.uint8], look: Mapping[str, Any], scale: float = 1.0) -> None:
    """Draws into uint8 (height, width, 3) BGR, a camera picture scaled by `scale`: a dot per view,
    the left eye red, the right cyan. look: render's message of that topic.
    """
    alpha_px = look["alpha_px"]
    if not alpha_px:  # before the first face
        return
    radius = min(max(alpha_px * scale / 8, 0.8), 4.0)
    rows, cols = look["grid"]
    dots = [
        (place_px(look, row, col), radius, GRID_BGR, cv2.FILLED)
        for row, col in itertools.product(range(rows), range(cols))
    ]
    for eye_px, colour in zip(look["eyes_px"], (LEFT_BGR, RIGHT_BGR), strict=True):
        if look["face"]:
            dots.append((eye_px, max(6.0 * scale, 3 * radius), colour, 1))
            dots.append((eye_px, max(2.0 * scale, radius), colour, cv2.FILLED))
    far_px = 4.0 * max(picture.shape) / scale
    for (x, y), size, colour, thickness in dots:
        if abs(x) < far_px and abs(y) < far_px:
            at = round(x * scale * (1 << _SHIFT)), round(y * scale * (1 << _SHIFT))
            size_px = max(1, round(size * (1 << _SHIFT)))
            cv2.circle(picture, at, size_px, colour, thickness, cv2.LINE_AA, _SHIFT)


class Pictures:
    """The pictures of one session as server-sent events."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._readers: dict[str, ring.Reader] = {}
        self._events: dict[str, bytes] = {}
        self._look: control.Message | None = None  # render's last message about the eyes
        # the ring of the picture on the screen
        self._lent = ""
        self._lease_end_ns = 0
        self._zmq = control.context()
        self._tap = self._zmq.socket(zmq.SUB)
        self._tap.setsockopt(zmq.RCVHWM, 100)
        self._tap.setsockopt(zmq.SUBSCRIBE, b"")
        control.connect(self._tap, session.run_dir, "tap")

    def event(self, which: str) -> bytes:
        """The newest picture.

        `camera`: with the grid of views over the eyes; `picture`: as on the screen. Empty without
        one.
        """
        try:
            reader = self._reader(which)
        # no camera, or the session has just ended
        except (UserError, FileNotFoundError, ValueError):
            return b""
        frame: NDArray[np.uint8] = np.empty(reader.shape, np.uint8)
        if reader.read(frame) is not None:
            scale = min(1.0, PICTURES[which] / max(frame.shape))
            frame = np.asarray(
                cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
            )
            if which == "camera" and (look := self._newest_look()) is not None:
                draw_over_eyes(frame, look, scale)
            jpeg = cv2.imencode(".jpg", frame, FULL_CHROMA)[1].tobytes()
            self._events[which] = b"event: %s\ndata: %s\n\n" % (
                which.encode(),
                base64.b64encode(jpeg),
            )
        return self._events[which]

    def _reader(self, which: str) -> ring.Reader:
        """The ring of pictures.

        It changes with the size; the lease of the screen's ring must be renewed.
        """
        if which == "picture" and now_ns() > self._lease_end_ns - LEASE_S / 2 * SECOND_NS:
            self._lent = str(
                ask(self.session.name, {"cmd": "pictures", "lease_s": LEASE_S}, COMMAND_S)["ring"]
            )
            self._lease_end_ns = now_ns() + int(LEASE_S * SECOND_NS)
        path = self.session.segment("frames" if which == "camera" else self._lent)
        reader = self._readers.get(which)
        if reader is None or not reader.is_at(path):
            if reader is not None:
                self._readers.pop(which).close()
            reader = self._readers[which] = ring.Reader(path)
            reader.last_seq = max(0, reader.published - 1)  # the current picture counts as new
            self._events[which] = b""
        return reader

    def _newest_look(self) -> control.Message | None:
        while self._tap.poll(0):
            message = control.decode(self._tap.recv())
            if message["topic"] == "look":
                self._look = message
        return self._look

    def close(self) -> None:
        """Releases the rings and the tap."""
        for reader in self._readers.values():
            reader.close()
        self._tap.close()
        self._zmq.term()


class Feed:
    """The samples for all viewers, in one event loop. One thread takes them, another one sends
    commands, in order.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.viewers = 0
        self._follower = Follower(name)
        self._pictures: Pictures | None = None
        self._sampling = ThreadPoolExecutor(1, "lfpipe-sample")
        self._commands = ThreadPoolExecutor(1, "lfpipe-ctl")
        self._sampler: asyncio.Task[None] | None = None
        self._news = asyncio.Condition()
        self._newest = self._newest_camera = b""
        self._ended = False

    async def events(self, with_camera: bool) -> AsyncGenerator[bytes]:
        """Yields the newest sample as server-sent events until the feed ends: metrics as JSON,
        pictures as JPEG in base64. with_camera: whether to include the camera's picture.
        """
        self.viewers += 1
        if self._sampler is None:
            self._sampler = asyncio.create_task(self._keep_sampling())
        try:
            while not self._ended:
                async with self._news:
                    await self._news.wait()
                yield self._newest + self._newest_camera if with_camera else self._newest
        finally:
            self.viewers -= 1

    async def command(self, message: control.Message) -> control.Message:
        """Returns the session's answer.

        `reset` counts drops and times from now on. Raises UserError.
        """
        loop = asyncio.get_running_loop()
        if message["cmd"] == "reset":
            await loop.run_in_executor(self._sampling, self._follower.reset)
            return {"ok": True}
        timeout_s = LOAD_S if message["cmd"] == "load" else COMMAND_S
        return await loop.run_in_executor(self._commands, ask, self.name, message, timeout_s)

    async def end(self) -> None:
        """Ends the streams and releases everything."""
        self._ended = True
        if self._sampler is not None:
            await self._sampler
        async with self._news:
            self._news.notify_all()
        for executor in (self._sampling, self._commands):
            executor.shutdown(cancel_futures=True)

    async def _keep_sampling(self) -> None:
        while self.viewers and not self._ended:
            self._newest, self._newest_camera = await asyncio.get_running_loop().run_in_executor(
                self._sampling, self._sample
            )
            async with self._news:
                self._news.notify_all()
            await asyncio.sleep(PERIOD_S)
        self._release_pictures()
        self._follower.close()
        self._sampler = None

    def _sample(self) -> tuple[bytes, bytes]:
        """The events for all viewers, and that of the camera's picture."""
        try:
            state = self._follower.read()
            watch = self._follower.watch
            if self._pictures is not None and (
                watch is None or watch.session is not self._pictures.session
            ):
                self._release_pictures()
            if state is not None and watch is not None:
                self._pictures = self._pictures or Pictures(watch.session)
                metrics = f"data: {json.dumps(metrics_of(state))}\n\n".encode()
                return metrics + self._pictures.event("picture"), self._pictures.event("camera")
        except Exception:  # a defect, or a half-removed session: viewers see "no session"
            log.exception("no sample of the session")
        return b'data: {"alive": false}\n\n', b""

    def _release_pictures(self) -> None:
        if self._pictures is not None:
            self._pictures.close()
        self._pictures = None
