"""Clock, histogram, status, notices, wake and control, each against its contract."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfpipe.host import segment
from lfpipe.host.segment import WrongSegment
from lfpipe.transport import control, status
from lfpipe.transport.clock import Ticker
from lfpipe.transport.histogram import (
    BUCKETS,
    HISTOGRAM,
    Histogram,
    bucket_of,
    middle_us,
    summary_ms,
)
from lfpipe.transport.notices import FACELESS_NS, FAULT_NS, faults, notices
from lfpipe.transport.status import ROW, Row, State, Table
from tests.support.refusal import refusal


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


def test_bucket_of_any_value_is_within_one_sixtyfourth() -> None:
    middles = np.array([middle_us(i) for i in range(BUCKETS)])
    assert (np.diff(middles) > 0).all() and [bucket_of(int(m)) for m in middles] == list(
        range(BUCKETS)
    )
    assert (np.diff(middles) / 2 <= np.maximum(middles[1:] / 64, 0.5)).all()


def test_histogram_counts_durations_that_cannot_be() -> None:
    histogram = Histogram(np.zeros((), HISTOGRAM))
    histogram.add_ns(-5)
    assert [int(histogram.record[name]) for name in ("count", "sum_ns", "max_ns")] == [1, 0, 0]
    for value in (1 << 53, 1 << 62, 1 << 63, 1 << 80):
        histogram.add_ns(value)
    assert summary_ms(histogram.record)["n"] == 5 and histogram.record["buckets"][-1] == 4
    assert histogram.record["sum_ns"] == histogram.record["max_ns"] == (1 << 63) - 1


def test_middle_us_is_the_middle_of_a_bucket() -> None:
    values: dict[int, list[int]] = {}
    for us in range(1 << 13):
        values.setdefault(bucket_of(us), []).append(us)
    assert all(
        middle_us(bucket) == (us[0] + us[-1]) / 2 and us == list(range(us[0], us[-1] + 1))
        for bucket, us in values.items()
    )
    assert (
        bucket_of((1 << 32) - 1)
        == bucket_of(1 << 32)
        == BUCKETS - 1
        > bucket_of((1 << 32) - (1 << 27))
    )


@given(st.lists(st.integers(0, 10**13), max_size=40))
def test_summary_ms_is_that_of_the_values(values_ns: list[int]) -> None:
    """To 0.1 us; percentiles by rank, as the middle of a bucket, at most the maximum."""
    histogram = Histogram()
    for value_ns in values_ns:
        histogram.add_ns(value_ns)
    ranked = sorted(values_ns) or [0]
    top_ms = max(values_ns, default=0) / 1e6
    expected = {
        "n": len(values_ns),
        "mean_ms": round(sum(values_ns) / 1e6 / max(len(values_ns), 1), 4),
        "max_ms": round(top_ms, 4),
    }
    for name, percent in (("p50_ms", 50), ("p95_ms", 95), ("p99_ms", 99)):
        rank = max(1, -(-percent * len(values_ns) // 100))
        expected[name] = round(min(middle_us(bucket_of(ranked[rank - 1] // 1000)) / 1e3, top_ms), 4)
    assert summary_ms(histogram.record) == pytest.approx(expected, abs=2e-4)


def test_status_row_is_seen_by_another_attachment() -> None:
    name = f"lfpipe-test-{os.getpid()}-status"
    memory = status.create(name, ["capture", "track"])
    table = Table(name, writable=True)
    row = Row(table.rows["track"])
    row["state"] = State.RUNNING
    for i in range(100):
        row.tick(i)
        row.measure(1000, 2_000_000, 3_000_000)
    del row
    table.close()
    watch = Table(name)
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
    del seen
    watch.close()
    memory.close()
    memory.unlink()


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
def test_status_table_refuses_another_version(data: bytes) -> None:
    """Another ring, one made just now, one of another version, one of other fields, anything else,
    and one that is cut short.
    """
    name = f"lfp-test-{os.getpid()}"
    memory = segment.create(name, max(len(data), 64))
    memory.buf[: len(data)] = data
    try:
        with pytest.raises(WrongSegment) as error:
            Table(name)
        named = "bytes of" if data is SIGNED else repr(data[:8])[2:-1]
        assert name in error.value.message and named in error.value.message and error.value.remedy
    finally:
        memory.close()
        memory.unlink()


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


@given(
    message=st.dictionaries(
        st.text(min_size=1, max_size=8).filter(lambda k: k != "v"), plain, max_size=5
    )
)
def test_decode_gives_what_was_encoded(message: dict[str, object]) -> None:
    try:
        assert control.decode(control.encode(message)) == {"v": control.VERSION, **message}
    except control.BadMessage as error:
        assert "deep" in str(error)


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
        msgpack.packb({"v": 1, "x": "a" * control.MAX_BYTES}),
        msgpack.packb({"v": 1, "x": deep}),
        b"\x91" * 50_000,
        msgpack.packb({"v": 1, 5: "x"}),
        msgpack.packb({"v": 1, "x": b"bytes"}),
        msgpack.packb({"v": 1, "x": msgpack.ExtType(1, b"a")}),
        msgpack.packb({"v": 2}),
    ):
        with pytest.raises(control.BadMessage):
            control.decode(data)


def test_request_to_nobody_is_refused_in_time(tmp_path: Path) -> None:
    assert "did not answer within 0.2 s" in str(
        refusal(control.request, tmp_path, {"cmd": "status"}, timeout_s=0.2)
    )


@pytest.mark.native("sockets with a path")
def test_request_ends_with_a_session_that_ends_before_it_answers(tmp_path: Path) -> None:
    def serve() -> None:
        with control.context() as ctx, ctx.socket(zmq.ROUTER) as session:
            control.bind(session, tmp_path, "ctl")
            assert session.poll(60_000) and session.recv_multipart()

    with ThreadPoolExecutor(1) as threads:
        threads.submit(serve)
        error = refusal(control.request, tmp_path, {"cmd": "load"}, timeout_s=60.0)
    assert "ended before it answered" in str(error)


T_NS = 10**12


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> dict[str, NDArray[np.void]]:
    monkeypatch.setattr("lfpipe.transport.notices.now_ns", lambda: T_NS)
    made = {name: np.zeros((), ROW) for name in ("capture", "track", "render")}
    for row in made.values():
        row["state"] = State.RUNNING
    made["render"]["t_face_ns"] = T_NS - FACELESS_NS
    return made


def told(rows: dict[str, NDArray[np.void]]) -> list[str]:
    return notices(rows, "capture", "render")


def test_notices_tell_a_missing_face_while_all_run(
    rows: dict[str, NDArray[np.void]],
) -> None:
    assert told(rows) == []
    rows["render"]["t_face_ns"] -= 1
    assert told(rows) == ["no face for 4 s: move into the camera's view"]
    rows["capture"]["state"] = State.READY
    assert told(rows) == ["camera lost, trying again"]
    rows["capture"]["state"] = State.NONE
    assert told(rows) == [], "the mouse is the viewer"


def test_notices_tell_a_fault_instead_of_a_missing_face(
    rows: dict[str, NDArray[np.void]],
) -> None:
    rows["render"]["t_face_ns"] -= 1
    rows["track"]["fault"] = b"the filter is broken"
    rows["track"]["fault_since_ns"] = T_NS - FAULT_NS
    assert list(faults(rows, T_NS)) == [], "a few frames"
    assert list(faults(rows, T_NS + 1)) == [("the filter is broken", False)]
    rows["track"]["outputs_faulty"] = rows["track"]["outputs_ok"] = 30
    rows["track"]["fault_since_ns"] -= 1
    assert list(faults(rows, T_NS)) == [("the filter is broken", True)]
    assert told(rows) == ["the filter is broken: the picture does not follow you"]


def test_judge_keeps_the_time_of_the_first_fault() -> None:
    row = Row(np.zeros((), ROW))
    row.judge("", True)
    assert (row["fault_since_ns"], row["outputs_ok"], row["outputs_faulty"]) == (0, 1, 0)
    row.judge("broken", False)
    since_ns = row["fault_since_ns"]
    row.judge("broken", False)
    assert row["fault_since_ns"] == since_ns > 0 and row["outputs_faulty"] == 2
    row.judge("", False)
    assert not row.record["fault"].item() and row["outputs_ok"] == 1, "nobody there proves nothing"
