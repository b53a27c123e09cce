"""The row of the stage `share` in the process table."""

from lfpipe.config import SessionOptions
from lfpipe.transport.context import Stage


def _asks_for(options: SessionOptions) -> tuple[str, ...]:
    streams_pictures = any(target.startswith("lsl") for target in options.extra("share"))
    return ("shown",) if streams_pictures else ()


# its work can wait, so it must not disturb capture and render
STAGE = Stage(
    name="share",
    module="lfpipe.extras.share.stage",
    needed=lambda options: bool(options.extra("share")),
    reads=("eyes", "shown"),
    asks_for=_asks_for,
    optional=True,
    own_core=True,
)
