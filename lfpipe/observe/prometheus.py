"""Metrics of a session in Prometheus' text format, served over HTTP and read from the status table at each scrape."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector
from tornado.web import Application

from lfpipe.observe.access import LOOPBACK, NOT_OURS, named, parse_address, url_of
from lfpipe.observe.server import Handler, Missing, listen, run
from lfpipe.observe.session_reader import FollowingReader
from lfpipe.supervisor.process_table import SHOWN_BY
from lfpipe.supervisor.snapshot import motion_to_photon
from lfpipe.transport.histogram import MIDDLES_US

BOUNDS_MS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 33, 50, 100, 200, 500, 1000)


def buckets(record: NDArray[np.void]) -> tuple[list[tuple[str, float]], float]:
    """A HISTOGRAM record as Prometheus' cumulative buckets, in seconds, and its sum in seconds."""
    counts = record["buckets"].copy()
    below = [(str(ms / 1e3), float(counts[ms * 1e3 >= MIDDLES_US].sum())) for ms in BOUNDS_MS]
    return [*below, ("+Inf", float(counts.sum()))], float(record["sum_ns"]) / 1e9


class SessionCollector(Collector):
    """A session by name, running or not: see `lfpipe_up`."""

    def __init__(self, name: str) -> None:
        self._follower = FollowingReader(name)

    def collect(self) -> Iterator[Metric]:
        """All metrics, for one scrape."""
        reading, watch, session = self._follower.read(), self._follower.watch, [self._follower.name]
        yield _one(GaugeMetricFamily("lfpipe_up", "1 while the session runs", labels=["session"]), session, watch is not None)
        if reading is None or watch is None:
            return
        yield _one(GaugeMetricFamily("lfpipe_camera_hz", "frames per second", labels=["session"]), session, reading.camera_hz)
        yield _one(GaugeMetricFamily("lfpipe_face", "1 while a face is detected", labels=["session"]), session, reading.face)
        level = GaugeMetricFamily("lfpipe_quality_level", "level of quality, 0 for full quality", labels=["session"])
        yield _one(level, session, reading.level)
        labels = ["session", "stage"]
        rate = GaugeMetricFamily("lfpipe_stage_hz", "outputs per second", labels=labels)
        drops = CounterMetricFamily("lfpipe_stage_dropped", "inputs never used", labels=labels)
        restarts = CounterMetricFamily("lfpipe_stage_restarts", "starts after the first", labels=labels)
        cpu = GaugeMetricFamily("lfpipe_stage_cpu_ratio", "fraction of a core over the last 10 s", labels=labels)
        nice = GaugeMetricFamily("lfpipe_stage_nice", "niceness", labels=labels)
        cores = GaugeMetricFamily("lfpipe_stage_cores", "cores that the stage may run on", labels=labels)
        left_out = CounterMetricFamily("lfpipe_stage_left_out", "inputs left out on purpose", labels=labels)
        memory = GaugeMetricFamily("lfpipe_stage_rss_bytes", "resident memory, shared pages included", labels=labels)
        spent = HistogramMetricFamily("lfpipe_stage_seconds", "time of one output", labels=[*labels, "part"])
        for stage in reading.stages:
            key, row = [*session, stage.name], watch.rows[stage.name]
            rate.add_metric(key, stage.rate_hz)
            drops.add_metric(key, int(row["drops"]))
            restarts.add_metric(key, stage.restarts)
            cpu.add_metric(key, stage.cpu_percent / 100)
            memory.add_metric(key, stage.rss_mb * 1e6)
            nice.add_metric(key, stage.nice)
            cores.add_metric(key, len(stage.cpus))
            left_out.add_metric(key, int(row["left_out"]))
            for part in ("wait", "busy"):
                spent.add_metric([*key, part], *buckets(row[part]))
        age = HistogramMetricFamily("lfpipe_picture_age_seconds", "sensor to screen", labels=["session"])
        age.add_metric(session, *buckets(watch.rows[SHOWN_BY]["age"]))
        ahead = HistogramMetricFamily("lfpipe_horizon_seconds", "how far ahead the eyes are predicted", labels=["session"])
        ahead.add_metric(session, *buckets(watch.rows[SHOWN_BY]["horizon"]))
        refreshes = CounterMetricFamily("lfpipe_refreshes", "refreshes of a screen that reports its blanks", labels=["session"])
        refreshes.add_metric(session, int(watch.rows[SHOWN_BY]["planned"]))
        judder = CounterMetricFamily(
            "lfpipe_refreshes_juddered", "those that showed another picture than planned", labels=["session"]
        )
        judder.add_metric(session, int(watch.rows[SHOWN_BY]["juddered"]))
        photon = GaugeMetricFamily(
            "lfpipe_motion_to_photon_seconds", "latency of a motion, at its onset and steady", labels=["session", "part"]
        )
        for part, value_ms in motion_to_photon(watch.rows[SHOWN_BY]).items():
            if value_ms is not None:
                photon.add_metric([*session, part.removesuffix("_ms")], value_ms / 1e3)
        yield photon
        yield from (rate, drops, left_out, restarts, cpu, nice, cores, memory, spent, age, ahead, refreshes, judder)


def _one(family: Any, labels: list[str], value: float) -> Metric:
    family.add_metric(labels, float(value))
    made: Metric = family
    return made


class Metrics(Handler):
    """The metrics, open to anyone who reaches the port: numbers, no picture, no command."""

    def initialize(self, registry: CollectorRegistry, host: str) -> None:
        """host: where the server is bound. On 127.0.0.1, pages of other sites cannot read it."""
        self._registry, self._host = registry, host

    def refusal(self) -> str:
        """The reason for refusing this request, or ""."""
        return "" if self._host != LOOPBACK or named(self.request.headers.get("Host", ""), self._host) else NOT_OURS

    async def get(self) -> None:
        """Sends the metrics in the format that the scraper prefers."""
        encode, kind = choose_encoder(self.request.headers.get("Accept", ""))
        await self.answer(encode(self._registry), kind)


def serve(name: str, address: str, tell: Callable[[str], None]) -> None:
    """Serves the metrics of session `name` until Ctrl-C. Raises UserError if the port is in use."""
    host, port = parse_address(address, "--prometheus")
    sockets = listen(host, port, "--prometheus")
    registry = CollectorRegistry(auto_describe=False)
    registry.register(SessionCollector(name))
    app = Application([("/(?:metrics)?", Metrics, {"registry": registry, "host": host})], default_handler_class=Missing)
    bound = url_of(host, int(sockets[0].getsockname()[1]))
    tell(f"metrics of session {name!r} on {bound}/metrics (Ctrl-C ends)")
    run(app, sockets)
