"""One sampler for any number of viewers of the page: it works only while somebody looks."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np

from lfpipe.errors import UserError
from lfpipe.observe.attachment import Attachment
from lfpipe.observe.meter import Counts, Reading, Times
from lfpipe.supervisor.snapshot import spans
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.histogram import MIDDLES_US

PERIOD_S = 0.25
IDLE_S = 3.0
EDGES_MS = np.geomspace(0.05, 100.0, 34)  # of the page's histograms; below and above go into the outer bins
_BIN = np.clip(np.searchsorted(EDGES_MS, MIDDLES_US / 1e3) - 1, 0, len(EDGES_MS) - 2)

T = TypeVar("T")


def binned(counts: Counts) -> list[int]:
    """A histogram on MIDDLES_US as counts between EDGES_MS."""
    made: list[int] = np.bincount(_BIN, counts, len(EDGES_MS) - 1).astype(np.int64).tolist()
    return made


def _times(times: Times) -> dict[str, float]:
    return {"n": times.n, "p50": times.p50_ms, "p95": times.p95_ms, "p99": times.p99_ms, "max": times.max_ms}


def message(reading: Reading | None, told: dict[str, Any]) -> dict[str, Any]:
    """What the page is told, times in ms."""
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
        "face": reading.face,
        "viewer": reading.viewer,
        "level": reading.level,
        "lowest_level": reading.lowest_level,
        "level_words": reading.level_words,
        "stages": stages,
        "age": _times(reading.age),
        "age_now": reading.age_now_ms,
        "horizon": _times(reading.horizon),
        "edges_ms": [round(float(edge), 3) for edge in EDGES_MS],
        "supervisor": {"cpu": round(reading.supervisor[0], 1), "rss": round(reading.supervisor[1], 1)},
        **told,
    }


class Feed:
    """Threads call it; one of its own samples, and lets go of the session IDLE_S after the last call."""

    def __init__(self, name: str) -> None:
        self._attachment = Attachment(name)
        self._changed = threading.Condition()
        self._count, self._text = 0, ""
        self._touched_ns, self._resting, self._ended = 0, True, False
        self._thread = threading.Thread(target=self._sample, name="lfpipe-feed", daemon=True)
        self._thread.start()

    def _touch(self) -> None:
        self._touched_ns = now_ns()
        if self._resting:
            self._resting = False
            self._changed.notify_all()

    def _sample(self) -> None:
        with self._changed:
            while not self._ended:
                if now_ns() - self._touched_ns > IDLE_S * SECOND_NS:
                    self._attachment.rest()
                    self._resting = True
                    self._changed.wait_for(lambda: self._ended or not self._resting)
                    continue
                self._text = json.dumps(message(self._attachment.read(), self._attachment.told()))
                self._count += 1
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._ended, PERIOD_S)

    def messages(self) -> Iterator[str]:
        """JSON texts, one a sample, until the feed ends."""
        with self._changed:
            seen = self._count  # an old sample says nothing of now
        while True:
            with self._changed:
                self._touch()
                self._changed.wait_for(lambda last=seen: self._ended or self._count > last, 1.0)  # type: ignore[misc]
                if self._ended:
                    return
                if self._count == seen:
                    continue
                seen, text = self._count, self._text
            yield text

    def using(self, act: Callable[[Attachment], T]) -> T:
        """The attachment's answer, with nobody else at it. Raises UserError as the attachment does."""
        with self._changed:
            if self._ended:
                raise UserError("the monitor is ending", "start it again")
            self._touch()
            return act(self._attachment)

    def end(self) -> None:
        """Ends the sampler and lets go of everything."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join()
        self._attachment.close()
