"""The process table: a stage is one row here, or an entry point of the group `lfpipe.stages`, and
one module with `main(context)`. No other module of this package names a stage.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from lfpipe.capture.spec import METRICS as CAPTURE_METRICS
from lfpipe.config import Config, SessionOptions
from lfpipe.config.session_options import MouseViewer
from lfpipe.eyes import EYES, SHOWN
from lfpipe.plugins import STAGES as PLUGGED
from lfpipe.plugins import load, plugins
from lfpipe.render.metrics import METRICS as RENDER_METRICS
from lfpipe.track.metrics import METRICS as TRACK_METRICS
from lfpipe.transport.context import Stage as Stage
from lfpipe.transport.ring import RingSpec

# scores a scene's methods; run by the packer, which must not import the rendering packages
SCORER = "lfpipe.render.plan:scores"
FRAMES_BYTES = 16 << 20


STAGES: tuple[Stage, ...] = (
    Stage(
        name="capture",
        module="lfpipe.capture.stage",
        needed=lambda options: (
            options.viewer.tracked
            or (bool(options.record) and not isinstance(options.viewer, MouseViewer))
        ),
        writes=("frames",),
        restart_on_viewer_change=True,
        metrics=CAPTURE_METRICS,
    ),
    Stage(
        name="track",
        module="lfpipe.track.stage",
        needed=lambda options: options.viewer.tracked,
        reads=("frames",),
        writes=("eyes",),
        restart_on_viewer_change=True,
        metrics=TRACK_METRICS,
        own_core=True,
    ),
    Stage(
        name="render",
        module="lfpipe.render.stage",
        needed=lambda options: options.show,
        reads=("eyes", "views", "disparity"),
        writes=("shown", "viewpoints"),
        metrics=RENDER_METRICS,
    ),
    # of a live light field
    Stage(
        name="views",
        module="lfpipe.capture.stage",
        needed=lambda options: options.live is not None,
        writes=("views",),
        metrics=CAPTURE_METRICS,
        optional=True,
    ),
    Stage(
        name="disparity",
        module="lfpipe.live.stage",
        needed=lambda options: options.live is not None and options.show,
        reads=("views",),
        writes=("disparity",),
        optional=True,
    ),
    *(load(PLUGGED, name) for name in plugins(PLUGGED)),
)

NAMES = tuple(stage.name for stage in STAGES)
METRICS = {stage.name: stage.metrics for stage in STAGES}
# The source makes frames, and when it ends by itself, the session ends.
# The age of pictures is the session's.
SOURCE, TRACKED_BY, SHOWN_BY = (
    next(stage.name for stage in STAGES if ring in stage.writes)
    for ring in ("frames", "eyes", "shown")
)
# work that a lowered quality reduces -> its stage
DOES = {"pictures": SHOWN_BY, "eyes": TRACKED_BY}
# the stages that a picture waits for
CORE = tuple(stage.name for stage in STAGES if not stage.optional)


def written(options: SessionOptions, specs: Mapping[str, RingSpec]) -> dict[str, RingSpec]:
    """Those of the rings that a session with these options writes. Eyes have a second writer:
    render, where the mouse is the viewer.
    """
    idle = {ring for stage in STAGES if not stage.needed(options) for ring in stage.writes}
    return {name: specs[name] for name in specs if name == "eyes" or name not in idle}


def rings(config: Config, options: SessionOptions) -> dict[str, RingSpec]:
    """The rings between the stages of a session, without those that it has on demand."""
    shape = (*reversed(config.camera.frame_px), 3)
    slots = min(max(FRAMES_BYTES // math.prod(shape), 4), 8)
    frames, eyes = RingSpec(shape, np.dtype("u1"), slots), RingSpec((), EYES, slots=8)
    return written(options, {"frames": frames, "eyes": eyes})


# rings that exist from the first time that a stage asks for them
ON_DEMAND = {"shown": RingSpec((), SHOWN, slots=16)}
# rings of a fixed name that exist from their first use to the end of the session: a process may
# still map one, and would not notice its replacement
LASTING = ("frames", "eyes", *ON_DEMAND)


def asked_for(options: SessionOptions) -> tuple[str, ...]:
    """The rings of ON_DEMAND that a session with these options needs."""
    rings = {ring for stage in STAGES if stage.needed(options) for ring in stage.asks_for(options)}
    return tuple(sorted(rings))


def picture_ring(height_px: int, width_px: int) -> RingSpec:
    """The ring of output pictures."""
    return RingSpec((height_px, width_px, 3), np.dtype("u1"), slots=3)


def consumers() -> dict[str, list[str]]:
    """ring -> names of the stages that read it."""
    return {
        name: [stage.name for stage in STAGES if name in stage.reads]
        for stage in STAGES
        for name in stage.writes
    }


def cores(allowed: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """stage -> cores: on two cores, stages with own_core get the second; with more, the operating
    system decides.
    """
    return (
        {stage.name: (sorted(allowed)[stage.own_core],) for stage in STAGES}
        if len(allowed) == 2
        else {}
    )
