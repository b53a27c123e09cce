"""What manifest.json of a pack says: everything but its arrays."""

from collections.abc import Mapping
from typing import Any

import attrs

from lfpipe.scene.source import Geometry, Turn

VERSION = 12  # of the pack; another version is another key


@attrs.frozen(kw_only=True)
class Depth:
    """Disparities of the farthest and the nearest things, px per grid step, positive is nearer."""

    min_px: float = 0.0
    max_px: float = 0.0
    # at the left and right border, which the edge of a screen cuts off
    border_low_px: float = 0.0
    border_high_px: float = 0.0

    @property
    def reach_px(self) -> float:
        """The largest disparity either way."""
        return max(-self.min_px, self.max_px)


@attrs.frozen(kw_only=True)
class Disparity(Depth):
    """Where the disparities of a pack are from, and the step of the stored maps."""

    source: str = "none"  # "truth" or "estimated"; of what is not packed yet, also "unknown"
    scale_px: float = 1 / 16


@attrs.frozen(kw_only=True)
class OrientationFacts:
    """The evidence for the order of the views, as `orientation.Orientation` has it."""

    by: str = "nothing"
    sure: bool = True
    reason: str = ""
    undecided: str = ""
    half_turn: bool = False  # whether near and far are exchanged in the pack
    half_turn_sure: bool = True


@attrs.frozen(kw_only=True)
class Manifest:
    """The content of manifest.json. Sizes are those of the arrays, in the order of the pack."""

    version: int = VERSION
    complete: bool = True  # whether the packer has measured the disparity, as far as there is any
    lfpipe: str = ""  # the version that made the pack
    key: str = ""  # of the cache; "" for what is not packed
    name: str = ""
    source: str = ""
    layout: str = ""
    files: int = 0
    created: str = ""
    rows: int = 0
    cols: int = 0
    frames: int = 0
    height: int = 0
    width: int = 0
    channels: int = 0
    bit_depth: int = 0
    frame_rate_hz: float = 0.0
    flips: Turn = attrs.field(factory=Turn)
    orientation: OrientationFacts = attrs.field(factory=OrientationFacts)
    gamma: float = 1.0
    gamma_by: str = ""
    geometry: Geometry = attrs.field(factory=Geometry)
    present: list[list[int]] = attrs.field(factory=list)  # by row and column, 1 or 0
    offsets: list[list[list[float]]] | None = None  # as in LightField; None on a regular grid
    disparity: Disparity = attrs.field(factory=Disparity)
    notes: tuple[str, ...] = ()
    # PSNR in dB of held-out views by method
    scores: Mapping[str, float] = attrs.field(factory=dict)
    method: str = ""  # that `auto` stands for; "" for what is not packed
    checksum: str = ""  # of the rest

    @property
    def views_shape(self) -> tuple[int, ...]:
        """(frames, rows, cols, channels, height, width)."""
        return self.frames, self.rows, self.cols, self.channels, self.height, self.width

    @property
    def disparity_shape(self) -> tuple[int, ...]:
        """(frames, rows, cols, half height, half width)."""
        return self.frames, self.rows, self.cols, (self.height + 1) // 2, (self.width + 1) // 2

    def exchanged(self) -> "Manifest":
        """With near and far exchanged: rows and columns reversed, disparities negated."""
        turn = self.flips
        depth = self.disparity
        return attrs.evolve(
            self,
            flips=attrs.evolve(turn, rows=not turn.rows, cols=not turn.cols),
            disparity=attrs.evolve(
                depth,
                min_px=0.0 - depth.max_px,  # never -0.0
                max_px=0.0 - depth.min_px,
                border_low_px=0.0 - depth.border_high_px,
                border_high_px=0.0 - depth.border_low_px,
            ),
        )

    def as_json(self) -> dict[str, Any]:
        """For json.dumps."""
        return attrs.asdict(self)
