"""Log-linear histogram on 64-bit counters that may be in shared memory: constant size, exact count,
sum and maximum.

Values are microseconds. Below 64 us each value has its own bucket; above, every power of two is
divided into 32. So the width of a bucket is at most 1/32 of its value, and the error of its middle
at most 1/64 = 1.6 % (the layout of HdrHistogram). One writer. Any process may read it at any time;
counts may then be off by one, but never corrupt.
"""

import numpy as np
from numpy.typing import NDArray

from lfpipe.files.untrusted import MAX_INTEGER

LAST_OCTAVE = 26  # values to 2^32 us, 71 minutes; longer values go to the last bucket
BUCKETS = (LAST_OCTAVE << 5) + 64  # 32 an octave, after 64 of single microseconds
MAX_NS = MAX_INTEGER  # of a 64-bit counter
Times = dict[str, float]  # of `summary_ms`
HISTOGRAM = np.dtype(
    [("count", "<i8"), ("sum_ns", "<i8"), ("max_ns", "<i8"), ("buckets", "<i8", (BUCKETS,))]
)


def bucket_of(us: int) -> int:
    """Index of the bucket for us, a whole number of microseconds; negative values count as 0."""
    if us < 64:
        return max(us, 0)
    shift = us.bit_length() - 6
    return min((shift << 5) + (us >> shift), BUCKETS - 1)


def middle_us(bucket: int) -> float:
    """The value that represents a bucket."""
    if bucket < 64:
        return float(bucket)
    shift = (bucket >> 5) - 1
    low = ((bucket & 31) + 32) << shift
    return low + ((1 << shift) - 1) / 2


MIDDLES_US = np.array([middle_us(i) for i in range(BUCKETS)])


class Histogram:
    """Writer's side.

    record: a scalar view of dtype HISTOGRAM (shape ()), for example a field of a status row.
    """

    def __init__(self, record: NDArray[np.void] | None = None) -> None:
        self.record: NDArray[np.void] = np.zeros((), HISTOGRAM) if record is None else record
        self._buckets = self.record["buckets"].data
        self._head = [self.record[name].reshape(1).data for name in ("count", "sum_ns", "max_ns")]

    def add_ns(self, value_ns: int) -> None:
        """Adds one duration in nanoseconds; a negative one counts as 0.

        Sum and maximum stop at MAX_NS.
        """
        value_ns = min(max(value_ns, 0), MAX_NS)
        self._buckets[bucket_of(value_ns // 1000)] += 1
        count, total, top = self._head
        count[0] += 1
        total[0] = min(total[0] + value_ns, MAX_NS)
        if value_ns > top[0]:
            top[0] = value_ns


def quantiles(times: Times, *keys: str) -> str:
    """These keys of a summary as text, for example `p50 41.2, p95 50.1 ms`."""
    return ", ".join(f"{key.removesuffix('_ms')} {times[key]:.1f}" for key in keys) + " ms"


def summary_ms(record: NDArray[np.void]) -> Times:
    """{"n", "mean_ms", "p50_ms", "p95_ms", "p99_ms", "max_ms"} of a HISTOGRAM record; zeros if it
    is empty.

    A percentile is the middle of the bucket with the value of that rank, but never more than the
    maximum.
    """
    counts = record["buckets"].copy()
    total = int(counts.sum())
    top_ms = float(record["max_ns"]) / 1e6
    out = {"n": total, "mean_ms": round(float(record["sum_ns"]) / 1e6 / total, 4) if total else 0.0}
    ranks = np.cumsum(counts)
    for name, share in (("p50_ms", 0.50), ("p95_ms", 0.95), ("p99_ms", 0.99)):
        at = int(np.searchsorted(ranks, max(1, np.ceil(share * total)))) if total else 0
        out[name] = round(min(float(MIDDLES_US[at]) / 1e3, top_ms), 4) if total else 0.0
    out["max_ms"] = round(top_ms, 4)
    return out
