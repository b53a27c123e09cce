"""One sampler for any number of viewers of the page. It works only while the page has viewers."""

import asyncio
import base64
import json
import logging
from collections.abc import AsyncGenerator
from typing import Any

import attrs
import numpy as np

from lfpipe.errors import UserError
from lfpipe.observe.attachment import Attachment
from lfpipe.observe.meter import Counts, Reading, Times
from lfpipe.observe.session_commands import AsyncSessionCommands
from lfpipe.supervisor.snapshot import spans
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.histogram import MIDDLES_US

PERIOD_S = 0.25
COMMAND_S, LOAD_S = 2.0, 20.0  # timeouts of answers; packing a scene may take longer
IDLE_S = 3.0
PICTURES = ("camera", "picture")
PICTURE_S = 0.2  # less than PERIOD_S: each sample has a new picture
RETRY_NS = SECOND_NS  # after no picture was available
EDGES_MS = np.geomspace(0.05, 100.0, 34)  # of the page's histograms; the outer bins hold everything below and above
_BIN = np.clip(np.searchsorted(EDGES_MS, MIDDLES_US / 1e3) - 1, 0, len(EDGES_MS) - 2)

log = logging.getLogger(__name__)


def binned(counts: Counts) -> list[int]:
    """A histogram on MIDDLES_US as counts between EDGES_MS."""
    made: list[int] = np.bincount(_BIN, counts, len(EDGES_MS) - 1).astype(np.int64).tolist()
    return made


def _times(times: Times) -> dict[str, float]:
    return {"n": times.n, "p50": times.p50_ms, "p95": times.p95_ms, "p99": times.p99_ms, "max": times.max_ms}


def message(reading: Reading | None, settings: dict[str, Any]) -> dict[str, Any]:
    """The message for the page, times in ms."""
    if reading is None:
        return {"alive": False}
    stages = [
        {
            "name": stage.name,
            "state": stage.state,
            "hz": round(stage.rate_hz, 2),
            "wait": _times(stage.wait),
            "busy": _times(stage.busy),
            "worst": stage.worst.max_ms,
            "dropped": stage.dropped,
            "restarts": stage.restarts,
            "cpu": round(stage.cpu_percent, 1),
            "rss": round(stage.rss_mb, 1),
            "cpus": spans(stage.cpus),
            "nice": stage.nice,
            "hist": binned(stage.busy_counts),
        }
        for stage in reading.stages
    ]
    return {
        "alive": True,
        "uptime_s": round(reading.uptime_s, 2),
        "camera_hz": round(reading.camera_hz, 2),
        "camera_light": reading.camera_light,
        "face": reading.face,
        "viewer": reading.viewer,
        "level": reading.level,
        "lowest_level": reading.lowest_level,
        "level_words": reading.level_words,
        "stages": stages,
        "age": _times(reading.age),
        "age_now": reading.age_now_ms,
        "horizon": _times(reading.horizon),
        "motion_to_photon": reading.motion_to_photon,
        "edges_ms": [round(float(edge), 3) for edge in EDGES_MS],
        "supervisor": {"cpu": round(reading.supervisor[0], 1), "rss": round(reading.supervisor[1], 1)},
        **settings,
    }


@attrs.define
class _Shot:
    """A picture shared by all viewers."""

    jpeg: bytes | None = None
    made_ns: int = 0
    lock: asyncio.Lock = attrs.field(factory=asyncio.Lock)


class Feed:
    """Belongs to one event loop. Releases the session IDLE_S after the last call."""

    def __init__(self, name: str) -> None:
        self.viewers = 0
        self._seers = 0  # viewers who also want the pictures
        self._attachment, self._remote = Attachment(name), AsyncSessionCommands(name)
        self._shots = {which: _Shot() for which in PICTURES}
        self._sampler: asyncio.Task[None] | None = None
        self._wake, self._touched_ns, self._ended = asyncio.Event(), 0, False
        self._next: asyncio.Future[tuple[bytes, bytes]] | None = None  # the next sample: figures, pictures

    async def events(self, pictures: bool) -> AsyncGenerator[bytes]:
        """Yields the newest sample as server-sent events until the feed ends: figures as JSON, pictures as JPEG in base64."""
        self.viewers += 1
        self._seers += pictures
        try:
            while not self._ended:
                self._touch()
                if self._next is None:
                    self._next = asyncio.get_running_loop().create_future()
                figures, seen = await asyncio.shield(self._next)
                if figures:
                    yield figures + seen if pictures else figures
        finally:
            self.viewers -= 1
            self._seers -= pictures

    async def picture(self, which: str) -> bytes | None:
        """JPEG of one of PICTURES, at most PICTURE_S old; None if there is none."""
        self._touch()
        shot = self._shots[which]
        async with shot.lock:
            if now_ns() - shot.made_ns > PICTURE_S * SECOND_NS and not self._ended:
                try:
                    camera = which == "camera"
                    shot.jpeg = self._attachment.camera() if camera else await self._attachment.picture()
                except (UserError, FileNotFoundError, ValueError):  # the session has just ended
                    shot.jpeg = None
                shot.made_ns = now_ns() + (0 if shot.jpeg else RETRY_NS)
            return shot.jpeg

    async def command(self, message: dict[str, Any]) -> dict[str, Any]:
        """Returns the session's answer. Raises UserError as ctl does."""
        return await self._remote.ask(message, LOAD_S if message["cmd"] == "load" else COMMAND_S)

    def reset(self) -> None:
        """Resets the histograms."""
        self._touch()
        self._attachment.reset()

    async def end(self) -> None:
        """Ends the streams and releases everything."""
        self._ended = True
        self._wake.set()
        if self._sampler is not None:
            await self._sampler
        self._attachment.close()
        self._remote.close()

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
                    self._attachment.rest()
                    await self._wake.wait()
                    continue
                figures = message(await self._attachment.read(), self._attachment.settings())
                pictures = [await self._event(which) for which in PICTURES if self._seers]
            except Exception:  # a defect, or a half-removed session: viewers see "no session"
                log.exception("no sample of the session")
                figures, pictures = message(None, {}), []
            self._tell(f"data: {json.dumps(figures)}\n\n".encode(), b"".join(pictures))
            await asyncio.sleep(PERIOD_S)
        self._tell(b"", b"")

    async def _event(self, which: str) -> bytes:
        jpeg = await self.picture(which)
        return b"event: %s\ndata: %s\n\n" % (which.encode(), base64.b64encode(jpeg)) if jpeg else b""

    def _tell(self, figures: bytes, pictures: bytes) -> None:
        told, self._next = self._next, None
        if told is not None:
            told.set_result((figures, pictures))
