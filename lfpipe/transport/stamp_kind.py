"""The source of a frame's sensor stamp."""

import enum


class StampKind(enum.IntEnum):
    """The number in a ring's slot; `word` is its name in the trace."""

    SCHEDULED = 0  # a recording's or the demo's scheduled time
    READ = 1  # no usable stamp: the time when the frame was read
    END_OF_FRAME = 2
    START_OF_EXPOSURE = 3
    START_OF_TRANSFER = 4  # uvcvideo: the first packet of the frame, which follows the exposure of the first row

    @property
    def word(self) -> str:
        return self.name.lower().replace("_", " ")
