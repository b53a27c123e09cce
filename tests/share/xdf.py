"""A minimal writer of XDF files as LabRecorder writes them (specification at github.com/sccn/xdf,
version 1.0).
"""

import struct
from collections.abc import Sequence
from pathlib import Path


def _chunk(tag: int, content: bytes) -> bytes:
    body = struct.pack("<H", tag) + content
    return b"\x04" + struct.pack("<I", len(body)) + body


def write_xdf(
    path: Path, streams: Sequence[tuple[str, Sequence[Sequence[float]], Sequence[float], float]]
) -> None:
    """streams: (header as liblsl's StreamInfo.as_xml gives it, samples of doubles, stamps,
    correction of the clock) each.
    """
    data = b"XDF:" + _chunk(1, b'<?xml version="1.0"?><info><version>1.0</version></info>')
    for number, (header, samples, stamps, correction) in enumerate(streams, 1):
        stream = struct.pack("<I", number)
        data += _chunk(2, stream + header.encode())
        data += _chunk(4, stream + struct.pack("<dd", stamps[0], correction))
        rows = b"".join(
            b"\x08" + struct.pack("<d", stamp) + struct.pack(f"<{len(row)}d", *row)
            for stamp, row in zip(stamps, samples, strict=True)
        )
        data += _chunk(3, stream + b"\x04" + struct.pack("<I", len(samples)) + rows)
        footer = (
            f"<info><first_timestamp>{stamps[0]}</first_timestamp>"
            f"<sample_count>{len(samples)}</sample_count></info>"
        )
        data += _chunk(6, stream + footer.encode())
    path.write_bytes(data)
