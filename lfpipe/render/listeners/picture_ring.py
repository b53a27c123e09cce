"""The ring of pictures, for previews and exports."""

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.files.decoding import fit_area
from lfpipe.render.presenter import Listener, Presentation
from lfpipe.render.synthesis.pair_layout import scale_into
from lfpipe.transport import ring
from lfpipe.transport.ring import Stamp


class PictureRing(Listener):
    """Writes every new picture to the ring of option "pictures". Without a request there is no ring
    and no copy.
    """

    def __init__(self, segment: Callable[[str], Path]) -> None:
        """segment: the shared memory of a ring."""
        self._segment = segment
        self._name = ""
        self._ring: ring.Writer | None = None
        self._picture: NDArray[np.uint8] | None = None  # on the screen, for a new ring

    def set_options(self, options: SessionOptions) -> None:
        if options.pictures == self._name:
            return
        self._name = options.pictures
        if self._ring is not None:
            self._ring.close()
        self._ring = None
        if options.pictures:
            with contextlib.suppress(FileNotFoundError):  # released before it was used
                self._ring = ring.Writer(self._segment(options.pictures))
        self._write(None)

    def handed_over(self, presentation: Presentation) -> None:
        self._picture = presentation.picture
        if presentation.composed:
            self._write(presentation.eyes.stamp if presentation.eyes else None)

    def _write(self, stamp: Stamp | None) -> None:
        """Writes the picture, scaled up where the screen shows less than the scene's own size;
        skips one of another aspect right after a change of scene.
        """
        picture = self._picture
        if self._ring is None or picture is None:
            return
        size_px = picture.shape[1], picture.shape[0]
        if fit_area((self._ring.shape[1], self._ring.shape[0]), size_px)[2:] != size_px:
            return
        scale_into(picture, self._ring.begin())
        if stamp is None:
            self._ring.publish(-1, 0, 0)
        else:
            self._ring.publish(
                stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
            )
