"""Eyes in a program's own pictures: the session's tracking without a session."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Self

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.api.arguments import typed
from lfpipe.config import Config, updated
from lfpipe.errors import UserError
from lfpipe.eyes import EYES, extrapolated
from lfpipe.track.eye_tracker import EyeTracker
from lfpipe.track.head import Head, HeadEstimator


@attrs.frozen(eq=False, kw_only=True)
class Eyes:
    """A viewer's eyes in one frame.

    Positions are [[left x, y], [right x, y]] of the viewer's own eyes, in px of the unmirrored
    picture.
    """

    t_ns: int
    """Time of the frame."""
    raw_px: NDArray[np.float64]
    """(2, 2), as measured."""
    filtered_px: NDArray[np.float64]
    """(2, 2), smoothed."""
    velocity_px_s: NDArray[np.float64]
    """(2, 2)."""
    confidence: float
    """0 to 1."""
    head: Head | None
    """In mm before the screen, see `lfpipe.track.head`; None for an impossible eye distance."""

    @classmethod
    def of(cls, record: NDArray[np.void], t_ns: int, head: Head | None) -> Eyes | None:
        """Converts a record of dtype EYES; None without a face."""
        if not record["face"]:
            return None
        raw_px, filtered_px, velocity_px_s = (
            record[name].copy() for name in ("raw_px", "filtered_px", "velocity_px_s")
        )
        return cls(
            t_ns=t_ns,
            raw_px=raw_px,
            filtered_px=filtered_px,
            velocity_px_s=velocity_px_s,
            confidence=float(record["confidence"]),
            head=head,
        )

    def predicted_px(self, t_ns: int) -> NDArray[np.float64]:
        """The predicted eyes.

        Parameters
        ----------
        t_ns : int
            On the clock of `t_ns`. Times more than a quarter of a second ahead count as that.

        Returns
        -------
        ndarray of float, (2, 2)
            px.
        """
        return extrapolated(self.filtered_px, self.velocity_px_s, t_ns - self.t_ns)


class Tracker:
    """Tracks one face from frame to frame, in this process.

    Parameters
    ----------
    settings : mapping, optional
        Of `track` and `camera`, for example {"track.filter": "one-euro"}.

    Raises
    ------
    UserError
        For wrong settings, and if the networks of the engine are missing.

    Examples
    --------
    >>> import numpy as np
    >>> with Tracker() as tracker:
    ...     print(tracker.update(np.zeros((480, 640, 3), np.uint8)))
    None
    """

    @typed
    def __init__(self, settings: Mapping[str, Any] | None = None) -> None:
        config = updated(Config(), settings or {})
        self._tracker = EyeTracker(config.track)
        self._estimator = HeadEstimator(config)
        self._record = np.zeros((), EYES)
        self._closed = False

    def update(self, frame: NDArray[Any], t_ns: int | None = None) -> Eyes | None:
        """The eyes in the next frame.

        Parameters
        ----------
        frame : ndarray of uint8, (height, width, 3)
            BGR, not mirrored.
        t_ns : int, optional
            Its time on any clock that never goes back; by default the monotonic clock's now.

        Returns
        -------
        Eyes or None
            None without a face.

        Raises
        ------
        UserError
            For anything but such a picture, and after `close`.
        """
        if self._closed:
            raise UserError("this Tracker is closed", "make a new one")
        is_array = isinstance(frame, np.ndarray)
        if (
            not is_array
            or frame.dtype != np.uint8
            or frame.ndim != 3
            or frame.shape[2] != 3
            or not frame.size
        ):
            what = f"{frame.dtype} {frame.shape}" if is_array else type(frame).__name__
            raise UserError(
                f"{what}: not a picture",
                "give uint8 (height, width, 3), blue first; cv2.cvtColor turns grey into colour",
            )
        t_ns = time.monotonic_ns() if t_ns is None else t_ns
        tracker = self._tracker
        tracker.update(tracker.engine.detect(frame), t_ns)
        tracker.write(self._record, frame)
        self._estimator.update(self._record, t_ns)
        tracker.engine.examine(frame)
        return Eyes.of(self._record, t_ns, self._estimator.head(self._record))

    def reset(self) -> None:
        """Forgets the current face."""
        self._tracker.reset()

    def close(self) -> None:
        """Releases the engine. May be called again."""
        if not self._closed:
            self._closed = True
            self._tracker.engine.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
