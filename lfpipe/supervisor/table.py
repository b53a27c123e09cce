"""The process table: a stage is one row here and one module with `main(context)`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from lfpipe.config import Config
from lfpipe.eyes import EYES
from lfpipe.transport.packet_ring import packet_dtype
from lfpipe.transport.ring import RingSpec


def _tracked(options: dict[str, Any]) -> bool:
    return bool(options["tracking"])


def _fed(options: dict[str, Any]) -> bool:
    return bool(options["tracking"] or options.get("record"))


def _shown(options: dict[str, Any]) -> bool:
    return bool(options.get("render", True))


def _recorded(options: dict[str, Any]) -> bool:
    return bool(options.get("record"))


@attrs.frozen
class Stage:
    """A process. needed: whether a session with these options runs it. start_s: the longest from spawn to READY;
    hang_s: the longest without a beat after that."""

    name: str
    module: str
    needed: Callable[[dict[str, Any]], bool]
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    start_s: float = 15.0
    hang_s: float = 2.0


FRAMES_BYTES = 16 << 20  # a recorder may be held up for as many frames as there are slots, less two

STAGES = (
    Stage("capture", "lfpipe.capture.stage", _fed, writes=("frames",)),
    Stage("track", "lfpipe.track.stage", _tracked, reads=("frames",), writes=("eyes",), start_s=30.0),
    Stage("render", "lfpipe.render.stage", _shown, reads=("eyes",)),
    Stage("record", "lfpipe.replay.recorder", _recorded, reads=("frames", "eyes")),
)


def _frame_ring(config: Config) -> RingSpec:
    shape = (config.camera.height_px, config.camera.width_px, 3)
    return RingSpec(shape, np.dtype("u1"), slots=min(max(FRAMES_BYTES // math.prod(shape), 4), 8))


def rings(config: Config) -> dict[str, RingSpec]:
    """What each ring holds in a session of this configuration."""
    return {
        "frames": _frame_ring(config),
        "eyes": RingSpec((), EYES, slots=8),
    }


def picture_ring(options: dict[str, Any]) -> RingSpec:
    """What the ring of output pictures holds. Raises UserError where the pack is gone."""
    from lfpipe.scene.store import open_pack

    field = open_pack(Path(options["pack"]))
    return RingSpec((field.height_px, field.width_px, 3), np.dtype("u1"), slots=3)


def packet_ring(config: Config, jpeg_px: Sequence[int]) -> RingSpec:
    """What the ring of a source's JPEGs of width, height jpeg_px holds: any that is no larger than its picture. A packet stays
    for longer than the frame that was made of it, which is published after it.
    """
    width_px, height_px = jpeg_px
    return RingSpec((), packet_dtype(width_px * height_px * 3), slots=_frame_ring(config).slots + 2)


def consumers() -> dict[str, list[str]]:
    """ring -> names of the stages that read it."""
    return {name: [stage.name for stage in STAGES if name in stage.reads] for stage in STAGES for name in stage.writes}
