"""What a session's stages need besides the configuration: facts detected by `up`, and later requests.

A stage receives all options at its start (pickled) and with each change (as a map in a control message).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs


@attrs.frozen
class SceneSummary:
    """Facts about a packed scene that a session needs without opening it.

    pack: the pack's folder, absolute. height_px, width_px: of a view. method: the method used for render.method = "auto".
    complete: whether the packer has finished; until then there is no disparity. scores: PSNR in dB of each method on held-out
    views. disparity_min_px, disparity_max_px: of the farthest and nearest points, px per view. half_turned: the views run against
    the order of the pack.
    """

    pack: str
    name: str
    rows: int
    cols: int
    height_px: int
    width_px: int
    method: str
    has_disparity: bool
    complete: bool = True
    scores: Mapping[str, float] = attrs.field(factory=dict)
    disparity_min_px: float = 0.0
    disparity_max_px: float = 0.0
    half_turned: bool = False

    def shown_as(self, half_turn: str) -> SceneSummary:
        """With near and far as scene.half_turn asks; "auto" leaves them as they are."""
        if half_turn == "auto" or (half_turn == "yes") == self.half_turned:
            return self
        low, high = -self.disparity_max_px, -self.disparity_min_px
        return attrs.evolve(
            self, disparity_min_px=low, disparity_max_px=high, half_turned=not self.half_turned
        )

    @property
    def needs_tracking(self) -> bool:
        """Whether the picture depends on the eyes: a single view looks the same from everywhere."""
        return self.rows * self.cols > 1


@attrs.frozen
class QualityLevel:
    """One level of quality. number: 0 for full quality. work: what it makes less of, "pictures" or "eyes", "" for level 0.
    method: how views are made. rate_hz: of the display's clock. every: n, one frame in n is tracked. words: for people."""

    number: int
    work: str
    method: str
    rate_hz: float
    every: int
    words: str


@attrs.frozen
class ReplayOutput:
    """Where a deterministic replay writes. folder: results. sequence: the recording replayed. pictures: whether to store some."""

    folder: str
    sequence: str
    pictures: bool


@attrs.frozen
class SessionOptions:
    """Paths are absolute; "" means none.

    source, source_hz: the camera or file, fully named. jpeg_px: (width, height) of the JPEGs that it delivers, None without.
    mouse: no camera, the mouse is the viewer. eyes: the source, if it is a recording of such a session. tracking: whether eyes
    are tracked. show: whether pictures are made. trace: file of one line per picture. still: file for the last picture.
    timeline: file of a trace that was started later. record: folder of a running recording. pictures, packets: names of rings
    that exist only on demand. lossless: no frame may be dropped, writers wait for readers. lock_step: besides, a frame passes
    every stage before the next one starts. share: where eyes are sent to, as `lfpipe.share.target` writes it. level: the
    quality in force, None for full.
    playlist, playlist_at: the scenes to step through, and the index of the one shown. kiosk: the code that ends an exhibition.
    start: begin with the thumbnails of the playlist. ask_glasses: ask which glasses the person has.
    """

    scene: SceneSummary | None = None
    source: str = ""
    source_hz: float = 0.0
    jpeg_px: tuple[int, int] | None = None
    tracking: bool = True
    mouse: bool = False
    eyes: str = ""
    show: bool = True
    display: str = "none"
    trace: str = ""
    still: str = ""
    timeline: str = ""
    record: str = ""
    pictures: str = ""
    packets: str = ""
    lossless: bool = False
    lock_step: bool = False
    replay: ReplayOutput | None = None
    share: tuple[str, ...] = ()
    playlist: tuple[str, ...] = ()
    playlist_at: int = 0
    kiosk: str = ""
    start: bool = False
    ask_glasses: bool = False
    level: QualityLevel | None = None

    @property
    def pack(self) -> str:
        """The scene's pack, "" without a scene."""
        return self.scene.pack if self.scene else ""

    @property
    def complete(self) -> bool:
        """Whether the scene has its disparity, as far as there is any."""
        return self.scene is None or self.scene.complete

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for messages and files."""
        return attrs.asdict(self)

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> SessionOptions:
        """The inverse of `to_dict`, unchecked."""
        classes = {"scene": SceneSummary, "replay": ReplayOutput, "level": QualityLevel}
        nested = {
            name: kind(**plain[name]) if plain[name] else None for name, kind in classes.items()
        }
        tuples = {
            name: tuple(plain[name]) if plain[name] is not None else None
            for name in ("jpeg_px", "share", "playlist")
        }
        return cls(**{**plain, **nested, **tuples})
