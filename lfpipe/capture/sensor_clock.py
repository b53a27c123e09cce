"""Converts a driver's time stamp to the middle of the exposure."""

from pathlib import Path

from lfpipe.transport.stamp_kind import StampKind

MAX_AGE_NS = 2_000_000_000  # an older stamp comes from another clock
HARDWARE_STAMPS = Path("/sys/module/uvcvideo/parameters/hwtimestamps")


def stamp_kind(driver: str, start_of_exposure: bool, hardware: Path = HARDWARE_STAMPS) -> StampKind:
    """The event that the driver's stamps mark. start_of_exposure: the flag of its buffers.

    uvcvideo sets that flag always, but stamps the arrival of the first packet (uvc_video_decode_start) unless its parameter
    hwtimestamps is set.
    """
    if not start_of_exposure:
        return StampKind.END_OF_FRAME
    if driver == "uvcvideo":
        try:
            by_camera = hardware.read_text().strip() not in ("0", "N")
        except OSError:
            by_camera = False
        return StampKind.START_OF_EXPOSURE if by_camera else StampKind.START_OF_TRANSFER
    return StampKind.START_OF_EXPOSURE


class SensorClock:
    """Moves stamps to the middle of the exposure.

    A stamp marks one end of the exposure, so half of the exposure time is added or subtracted. If the camera does not report it,
    half a frame period is assumed, which is off by at most a quarter of a period. The sensor's readout time is unknown and not
    corrected.

    Drivers may stamp ahead of the clock (vivid: the end of a future frame). Stamps ahead by up to one period are used, all
    shifted back by the largest lead so far: they stay evenly spaced, and no frame is read before its exposure.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = int(1e9 / rate_hz)
        self._lead_ns = 0

    def usable(self, stamp_ns: int, read_ns: int) -> bool:
        """Whether the stamp of a frame read at read_ns is from the monotonic clock."""
        return stamp_ns > 0 and -self._period_ns <= read_ns - stamp_ns <= MAX_AGE_NS

    def middle_ns(self, stamp_ns: int, kind: StampKind, read_ns: int, exposure_ns: int | None) -> tuple[int, StampKind]:
        """The middle of the exposure of a frame read at read_ns, never later than read_ns, and the source of the value."""
        if not self.usable(stamp_ns, read_ns):
            return read_ns, StampKind.READ
        self._lead_ns = max(self._lead_ns, stamp_ns - read_ns)
        half_ns = (self._period_ns // 2 if exposure_ns is None else min(exposure_ns, self._period_ns)) // 2
        sign = 1 if kind == StampKind.START_OF_EXPOSURE else -1
        return min(stamp_ns - self._lead_ns + sign * half_ns, read_ns), kind
