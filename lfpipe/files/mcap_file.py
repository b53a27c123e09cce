"""MCAP files, which Foxglove opens: messages of JSON with their schemas, written and read by the library mcap.

Chunks are not compressed: their pictures are, and an uncompressed chunk cannot expand beyond its size. Input is untrusted:
every record has a size limit, and every fault raises UserError.
"""

import contextlib
import importlib.util
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from lfpipe.errors import UserError
from lfpipe.files.safe_files import PRIVATE, create_private, open_regular, reason

RECORD_BYTES = 64 << 20  # of a record or chunk: a raw frame of 16 megapixels
CHUNK_BYTES = 1 << 20
LIBRARY = "lfpipe"
COPY = "copy it again from where `lfpipe sequence export` wrote it"

TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
BYTES = {"type": "string", "contentEncoding": "base64"}


def schema(title: str, **properties: Any) -> dict[str, Any]:
    """A JSON schema of an object."""
    return {"title": title, "type": "object", "properties": properties}


def check_library() -> None:
    """Raises UserError if mcap is not installed."""
    if importlib.util.find_spec("mcap") is None:
        raise UserError("MCAP files need the library mcap, which is not installed", "pip install 'lfpipe[media]'")


def time_of(t_ns: int) -> dict[str, int]:
    """A time in the form of Foxglove's schemas."""
    return {"sec": t_ns // 1_000_000_000, "nsec": t_ns % 1_000_000_000}


class McapFile:
    """A new file, private to its owner; removed if the body raises. Raises UserError if it cannot be written."""

    def __init__(self, path: Path) -> None:
        check_library()
        self._path = path
        try:
            self._file: IO[bytes] = create_private(path, PRIVATE)
        except FileExistsError:
            raise UserError(f"{path}: already exists", "use another name; nothing is overwritten") from None
        except OSError as error:
            raise self._wrong(error) from None
        from mcap.writer import CompressionType, Writer

        self._writer: Any = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE)
        self._writer.start(library=LIBRARY)
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}

    def channel(self, topic: str, title: str, described: dict[str, Any]) -> None:
        """Announces a topic and the schema of its messages."""
        number = self._writer.register_schema(title, "jsonschema", json.dumps(described).encode())
        self._channels[topic] = int(self._writer.register_channel(topic, "json", number))

    def message(self, topic: str, t_ns: int, data: bytes) -> None:
        """One message, JSON."""
        count = self._counts[topic] = self._counts.get(topic, -1) + 1
        self._writer.add_message(self._channels[topic], t_ns, data, t_ns, count)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Adds an attachment."""
        self._writer.add_attachment(0, 0, name, media_type, data)

    def _wrong(self, error: OSError) -> UserError:
        return UserError(f"{self._path}: {reason(error)}", "use a writable directory on a disk with free space")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if error is None:
                self._writer.finish()
                self._file.flush()
        except OSError as late:
            error = late
        with contextlib.suppress(OSError):
            self._file.close()
        if error is None:
            return
        self._path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise self._wrong(error) from None


def read_records(path: Path) -> Iterator[tuple[str, bytes]]:
    """(topic, data) of every message and (name, data) of every attachment, in the file's order.

    Raises UserError if it is not an MCAP file, or is damaged.
    """
    check_library()
    from mcap.exceptions import McapError
    from mcap.records import Attachment, Channel, Chunk, Message
    from mcap.stream_reader import StreamReader, breakup_chunk

    topics: dict[int, str] = {}
    try:
        with open_regular(path) as file:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=RECORD_BYTES).records:
                if isinstance(record, Attachment):
                    yield record.name, record.data
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                if not isinstance(record, Chunk):
                    continue
                if record.compression:
                    what = f"its chunks are compressed ({record.compression!r:.20})"
                    raise UserError(f"{path}: {what}", f"use `mcap decompress`, or {COPY}")
                for each in breakup_chunk(record, validate_crc=True):
                    if isinstance(each, Channel):
                        topics[each.id] = each.topic
                    elif isinstance(each, Message):
                        yield topics[each.channel_id], each.data
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {reason(error)}", COPY) from None
    except (McapError, ValueError, KeyError, IndexError, OverflowError, struct.error) as error:
        what = f"{type(error).__name__} {error}".strip()
        raise UserError(f"{path}: not a whole MCAP file ({what:.200})", COPY) from None
