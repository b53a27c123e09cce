"""The process table: a stage is one row here and one module with `main(context)`. No other module of this room names a stage.

Also the cores and niceness of stages, from `governor.affinity` and `governor.nice`.
"""

import math
from collections.abc import Callable, Iterable, Sequence

import attrs
import numpy as np

from lfpipe.config import Config, SessionOptions
from lfpipe.errors import UserError
from lfpipe.eyes import EYES, SHOWN
from lfpipe.transport.packet_ring import packet_dtype
from lfpipe.transport.ring import RingSpec


def _feeds(options: SessionOptions) -> bool:
    return options.tracking or bool(options.record and not options.mouse)


@attrs.frozen
class Stage:
    """A process. needed: whether a session with these options runs it.

    source: it makes frames, and when it ends by itself, the session ends. shows: it presents pictures; their age is the
    session's. optional: few sessions run it, and no picture waits for it. own_core: on two cores it avoids the first.
    startup_timeout_s: from spawn to READY, or to open another scene or camera. hang_timeout_s: longest time without a beat after
    that.
    """

    name: str
    module: str
    needed: Callable[[SessionOptions], bool]
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    source: bool = False
    shows: bool = False
    optional: bool = False
    own_core: bool = False
    startup_timeout_s: float = 15.0
    hang_timeout_s: float = 2.0


FRAMES_BYTES = 16 << 20  # a recorder may fall behind by the number of slots minus two

STAGES = (
    Stage("capture", "lfpipe.capture.stage", _feeds, writes=("frames",), source=True),
    Stage(
        "track",
        "lfpipe.track.stage",
        lambda options: options.tracking,
        reads=("frames",),
        writes=("eyes",),
        own_core=True,
        startup_timeout_s=30.0,
    ),
    Stage("render", "lfpipe.render.stage", lambda options: options.show, reads=("eyes",), writes=("shown",), shows=True),
    Stage(
        "record",
        "lfpipe.record.stage",
        lambda options: bool(options.record),
        reads=("frames", "eyes"),
        optional=True,
        own_core=True,  # its work can wait, so it must not disturb capture and render
    ),
    Stage(
        "share", "lfpipe.share.stage", lambda options: bool(options.share), reads=("eyes", "shown"), optional=True, own_core=True
    ),
)
NAMES = tuple(stage.name for stage in STAGES)
SOURCE = next(stage.name for stage in STAGES if stage.source)
SHOWN_BY = next(stage.name for stage in STAGES if stage.shows)
TRACKED_BY = next(stage.name for stage in STAGES if "eyes" in stage.writes)
DOES = {"pictures": SHOWN_BY, "eyes": TRACKED_BY}  # work that a lowered quality reduces -> who does it
CORE = tuple(stage.name for stage in STAGES if not stage.optional)  # the stages that a picture waits for


def _frame_ring(config: Config) -> RingSpec:
    width_px, height_px = config.camera.frame_px
    shape = (height_px, width_px, 3)
    return RingSpec(shape, np.dtype("u1"), slots=min(max(FRAMES_BYTES // math.prod(shape), 4), 8))


def rings(config: Config) -> dict[str, RingSpec]:
    """The rings that every session with this configuration has."""
    return {
        "frames": _frame_ring(config),
        "eyes": RingSpec((), EYES, slots=8),
        "shown": RingSpec((), SHOWN, slots=16),
    }


def picture_ring(height_px: int, width_px: int) -> RingSpec:
    """The ring of output pictures."""
    return RingSpec((height_px, width_px, 3), np.dtype("u1"), slots=3)


def packet_ring(config: Config, jpeg_px: Sequence[int]) -> RingSpec:
    """The ring of a source's JPEGs, (width, height) jpeg_px. A slot fits any JPEG that is no larger than its decoded picture.

    A packet is kept longer than the frame decoded from it, because that frame is published later.
    """
    width_px, height_px = jpeg_px
    return RingSpec((), packet_dtype(width_px * height_px * 3), slots=_frame_ring(config).slots + 2)


def consumers() -> dict[str, list[str]]:
    """ring -> names of the stages that read it."""
    return {name: [stage.name for stage in STAGES if name in stage.reads] for stage in STAGES for name in stage.writes}


NICENESS = range(-20, 20)  # as the kernel takes it


def _by_stage(key: str, text: str, example: str) -> dict[str, str]:
    """`a=1,b=2` as a map. Raises UserError for anything else, and for an unknown name."""
    values = {}
    for entry in filter(None, (entry.strip() for entry in text.split(","))):
        name, sign, value = entry.partition("=")
        if not sign or name.strip() not in NAMES:
            raise UserError(f"{key}: {entry!r} is not STAGE=VALUE with a stage of {', '.join(NAMES)}", f"for example: {example}")
        values[name.strip()] = value.strip()
    return values


def cores(text: str, allowed: Iterable[int]) -> dict[str, tuple[int, ...]]:
    """stage -> cores, from `governor.affinity`; the operating system places stages that are not listed.

    auto: on two cores, stages with own_core get the second; with more, the operating system decides. Raises UserError for
    invalid text and for a core that is not allowed.
    """
    usable = sorted(allowed)
    if text == "auto":
        return {stage.name: (usable[stage.own_core],) for stage in STAGES} if len(usable) == 2 else {}
    if text == "none":
        return {}
    example = f"track={usable[-1]},render={usable[0]}, or {usable[0]}+{usable[-1]} for either; auto; none"
    cores_of: dict[str, tuple[int, ...]] = {}
    for name, value in _by_stage("governor.affinity", text, example).items():
        numbers = value.split("+")
        if not all(number.isdecimal() for number in numbers):
            raise UserError(f"governor.affinity: {name}={value}: expected cores joined by +", f"for example: {example}")
        cores_of[name] = tuple(sorted({int(number) for number in numbers}))
        if missing := set(cores_of[name]) - set(usable):
            remedy = f"use one of {', '.join(map(str, usable))}"
            raise UserError(f"governor.affinity: {name}={value}: core {min(missing)} does not exist on this machine", remedy)
    return cores_of


def niceness(text: str) -> dict[str, int]:
    """stage -> niceness, from `governor.nice`. Raises UserError for invalid text."""
    example = "render=0,track=5"
    nice: dict[str, int] = {}
    for name, value in _by_stage("governor.nice", text, example).items():
        if not value.removeprefix("-").isdecimal() or int(value) not in NICENESS:
            raise UserError(f"governor.nice: {name}={value}: not a whole number from -20 to 19", f"for example: {example}")
        nice[name] = int(value)
    return nice
