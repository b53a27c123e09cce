"""Frames of another program's live scene: its views as one picture, a mosaic."""

import math
import time

import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.errors import UserError
from lfpipe.live.shared_scene import attached, has_writer
from lfpipe.transport.clock import POLL_S, SECOND_NS, now_ns
from lfpipe.transport.ring import StampKind

WAIT_NS = SECOND_NS // 2  # until a timeout, before which the writer's end is noticed
RATE_HZ = 1.0  # that it draws at least: more slowly, it counts as stalled for a while


class RingSource:
    """The newest frames of the ring of a live scene."""

    def __init__(self, name: str) -> None:
        """Raises UserError if no program writes it."""
        self._name = name
        self._reader, (rows, cols), (width, height) = attached(name)
        if not has_writer(name):
            self._reader.close()
            raise UserError(f"ring:{name}: its program has ended", "start it again")
        self._grid = rows, height, cols, width, 3
        self._next_seq = 0
        size_px = cols * width, rows * height
        self.info = SourceInfo(f"ring:{name}", size_px, RATE_HZ, live=True)

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`. Raises UserError when the program has ended, or came back with
        other views.
        """
        if out.size != math.prod(self._grid):
            rows, height, cols, width, _ = self._grid
            raise UserError(
                f"ring:{self._name}: its program draws {rows}x{cols} views of {width}x{height} px"
                " now",
                "end this session and start it again",
            )
        until_ns = now_ns() + WAIT_NS
        while now_ns() < until_ns:
            if (peeked := self._reader.peek()) is not None:
                stamp, record = peeked
                tiles = out.reshape(self._grid)
                np.copyto(tiles, record["views"].transpose(0, 2, 1, 3, 4))
                if self._reader.still_valid(stamp):
                    self._next_seq += 1
                    t_read_ns = now_ns()
                    return Frame(
                        self._next_seq - 1, stamp.t_sensor_ns, t_read_ns, stamp=StampKind.READ
                    )
            time.sleep(POLL_S)
        if not has_writer(self._name):
            raise UserError(f"ring:{self._name}: its program has ended", "start it again")
        raise TimeoutError

    def close(self) -> None:
        self._reader.close()
