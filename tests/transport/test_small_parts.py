"""Clock, histogram, status, metrics, wake and control, each against its contract."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.host.files import WrongSegment
from lfpipe.transport import control, status
from lfpipe.transport.ring import Ticker
from lfpipe.transport.status import (
    MAX_VALUES,
    NO_METRICS,
    ROW,
    Histogram,
    Kind,
    Metric,
    MetricSet,
    Row,
    State,
    Table,
    summary_ms,
)
from tests.support.refusal import refusal

LAST_MS = ((1 << 32) - (1 << 26)) / 1e3  # of the last bucket, its middle


@given(rate=st.floats(0.5, 500), k=st.integers(1, 5000))
def test_ticker_does_not_drift(rate: float, k: int) -> None:
    ticker = Ticker(rate, 10)
    for _ in range(k):
        ticker.advance(ticker.due_ns())
    assert abs(ticker.due_ns() - 10 - k * 1e9 / rate) <= 1


@given(late=st.integers(0, 10_000_000_000))
def test_ticker_skips_to_the_future(late: int) -> None:
    ticker = Ticker(100.0, 0)
    ticker.advance(late)
    assert late < ticker.due_ns() <= late + 10_000_000


@given(st.lists(st.integers(-10, 1 << 80) | st.integers(0, 10**9), max_size=40))
def test_summary_ms_is_that_of_the_values(values_ns: list[int]) -> None:
    """To 0.1 us; percentiles by rank, to 1/64, at most the maximum. Durations that cannot be are
    the nearest ones that can.
    """
    histogram = Histogram()
    for value_ns in values_ns:
        histogram.add_ns(value_ns)
    ranked = sorted(min(max(value_ns, 0), (1 << 63) - 1) for value_ns in values_ns) or [0]
    found = summary_ms(histogram.record)
    assert found["n"] == len(values_ns)
    assert found["max_ms"] == pytest.approx(ranked[-1] / 1e6, abs=1e-4)
    mean_ms = min(sum(ranked), (1 << 63) - 1) / 1e6 / len(ranked)
    assert found["mean_ms"] == pytest.approx(mean_ms, abs=1e-4)
    for name, percent in (("p50_ms", 50), ("p95_ms", 95), ("p99_ms", 99)):
        exact_ms = ranked[max(1, -(-percent * len(ranked) // 100)) - 1] / 1e6
        held_ms = min(exact_ms, LAST_MS)  # in the last bucket
        # 1 us: the fraction of a microsecond does not count
        assert abs(found[name] - held_ms) <= held_ms / 64 + 1e-3, (name, exact_ms)
        assert found[name] <= found["max_ms"]


METRICS = MetricSet(
    Metric("faces", Kind.COUNT, "frames with a face"),
    Metric("onset_ns", Kind.DURATION, "latency at the onset of a motion"),
    Metric("steady_ns", Kind.DURATION, "latency in motion"),
    Metric("prediction", Kind.HISTOGRAM, "how far eyes are predicted"),
    Metric("seat", Kind.STATE, "whether somebody is seated", ("free", "taken")),
    Metric("dim", Kind.FLAG, "whether there is too little light"),
)


def test_status_row_is_seen_by_another_attachment(tmp_path: Path) -> None:
    path = tmp_path / "status"
    memory = status.create(path, {"capture": NO_METRICS, "track": METRICS})
    table = Table(path, writable=True)
    row = Row(table.rows["track"], METRICS)
    row["faces"] += 3
    row["onset_ns"] = 61_200_000
    row["seat"] = 1
    row.histograms["prediction"].add_ns(2_000_000)
    row["state"] = State.RUNNING
    for i in range(100):
        row.count_output(i)
        row.record_latency(1000, 2_000_000, 3_000_000)
    del row
    table.close()
    watch = Table(path)
    seen = watch.rows["track"]
    assert (int(seen["seq"]), int(seen["source_seq"]), int(seen["busy_ns"])) == (
        100,
        99,
        200_000_000,
    )
    assert summary_ms(seen["busy"])["p50_ms"] == pytest.approx(2, rel=0.02)
    assert list(watch.rows) == ["capture", "track"] and int(watch.rows["capture"]["seq"]) == 0
    with pytest.raises(ValueError, match="read-only"):
        seen["seq"] = 5
    assert watch.metrics["capture"].read(watch.rows["capture"]) == {}
    metrics = watch.metrics["track"].read(seen)
    assert metrics.pop("prediction") == summary_ms(seen["histograms"][0])
    assert metrics == {
        "faces": 3,
        "onset_ms": 61.2,
        "steady_ms": None,
        "seat": "taken",
        "dim": False,
    }
    assert [one.meaning for one in watch.metrics["track"]] == [one.meaning for one in METRICS]
    del seen
    watch.close()
    memory.remove()


def test_status_table_refuses_what_does_not_fit(tmp_path: Path) -> None:
    wide = MetricSet(*(Metric(f"m{at}", Kind.COUNT, "x" * 1000) for at in range(MAX_VALUES)))
    with pytest.raises(ValueError, match="do not fit"):
        status.create(tmp_path / "x", {"capture": wide})
    with pytest.raises(ValueError, match="do not fit"):
        many = dict.fromkeys(map(str, range(status.PAGE_ROWS + 1)), NO_METRICS)
        status.create(tmp_path / "x", many)


SIGNED = status.MAGIC + status.LAYOUT.to_bytes(8, "little")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"LFRING1\0",
        b"LFSTAT1\0",
        b"LFSTAT0\0" + bytes(2**17),
        status.MAGIC + bytes(2**17),
        b"x" * 2**17,
        SIGNED,
    ],
)
def test_status_table_refuses_another_version(tmp_path: Path, data: bytes) -> None:
    """Another ring, one made just now, one of another version, one of other fields, anything else,
    and one that is cut short.
    """
    path = tmp_path / "status"
    path.write_bytes(data.ljust(64, b"\0"))
    with pytest.raises(WrongSegment) as error:
        Table(path)
    named = "of this version" if data.startswith(SIGNED) else repr(data[:8])[2:-1]
    assert str(path) in error.value.message and named in error.value.message
    assert error.value.remedy


def test_rate_hz_is_that_of_the_newest() -> None:
    record = np.zeros((), status.ROW)
    assert status.rate_hz(record) == 0.0
    record["recent_ns"][:10] = 10**12 + np.arange(10) * 20_000_000
    assert status.rate_hz(record, 10**12 + 200_000_000) == pytest.approx(50)
    assert status.rate_hz(record, 10**12 + 5_000_000_000) == 0.0


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**60), 2**60)
    | st.floats(allow_nan=False)
    | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=12,
)


@given(data=st.binary(max_size=300) | plain.map(msgpack.packb))
def test_decode_refuses_random_bytes(
    data: bytes,
) -> None:
    with pytest.raises(control.BadMessage):
        control.decode(data)


def test_decode_refuses_hostile_sizes_depths_and_types() -> None:
    deep: object = 1
    for _ in range(500):
        deep = [deep]
    for data in (
        b"\xdf\xff\xff\xff\xff",  # a map of 4 billion pairs
        msgpack.packb({"v": 2, "x": "a" * control.MAX_BYTES}),
        msgpack.packb({"v": 2, "x": deep}),
        b"\x91" * 50_000,
        msgpack.packb({"v": 2, 5: "x"}),
        msgpack.packb({"v": 2, "x": b"bytes"}),
        msgpack.packb({"v": 2, "x": msgpack.ExtType(1, b"a")}),
        msgpack.packb({"v": 0}),
    ):
        with pytest.raises(control.BadMessage):
            control.decode(data)


@pytest.mark.native("sockets with a path")
def test_request_ends_with_a_session_that_ends_before_it_answers(tmp_path: Path) -> None:
    def serve() -> None:
        with control.context() as ctx, ctx.socket(zmq.ROUTER) as session:
            session.bind(f"ipc://{tmp_path / 'ctl'}")
            assert session.poll(60_000) and session.recv_multipart()

    with ThreadPoolExecutor(1) as threads:
        threads.submit(serve)
        error = refusal(control.request, tmp_path, {"cmd": "load"}, timeout_s=60.0)
    assert "ended before it answered" in str(error)


def test_report_health_keeps_the_time_of_the_first_fault() -> None:
    row = Row(np.zeros((), ROW))
    row.report_health("", True)
    assert (row["fault_since_ns"], row["outputs_ok"], row["outputs_faulty"]) == (0, 1, 0)
    row.report_health("broken", False)
    since_ns = row["fault_since_ns"]
    row.report_health("broken", False)
    assert row["fault_since_ns"] == since_ns > 0 and row["outputs_faulty"] == 2
    row.report_health("", False)
    assert not row.record["fault"].item() and row["outputs_ok"] == 1, "nobody there proves nothing"
