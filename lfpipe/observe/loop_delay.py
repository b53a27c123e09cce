"""The delay of the loop (camera and display together), from a camera's recording of a screen that flips between black and white.

A frame with stamp t sees the screen's light, averaged over its exposure, as it was presented `delay` earlier. The light of a flip
rises and falls exponentially (pixel response). The delay runs from the present to the middle of the exposure that sees it. It
includes the mean of the response and holds for the middle row of the camera's picture: rows above are read earlier, rows below
later.

What the camera should see is computed for many delays, exposures and responses, and correlated with what it saw, in each of some
bands of rows. A short exposure in step with the screen sees only black or white, and shows little of the time between: many
delays then correlate equally well, and the interval is wide.
"""

import itertools
import math
from typing import Self

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError

SLOW_S = 1.0  # slower changes come from the room's light and automatic exposure
DELAYS_MS = (-20.0, 480.0)  # searched; television sets with picture processing reach 350
COARSE_STEP_MS, COARSE_EXPOSURES_MS, COARSE_RESPONSE_MS = (
    2.0,
    (4.0, 16.0, 33.0),
    1.0,
)  # near enough to find the screen
NEAR_MS, STEP_MS = (
    30.0,
    0.5,
)  # around the coarse delay: half of the longest readout; half of the error that is allowed
SEARCH_MS = 8.0  # around the best delay: an interval that reaches further is refused
# Exposures, from a bright room's to twice the longest hold of the pattern, and responses of pixels. Finer steps gained nothing.
MODELS = tuple(itertools.product(np.geomspace(1.5, 100.0, 18).tolist(), (0.7, 3.0)))
# Of a usual camera, and light of the room as a share of the screen's: where they are others, rises and falls of the light seem to
# be off in opposite directions, and the delay stays.
GAMMA, STRAY = 2.1, 0.05
BANDS = 6  # of rows: enough for the time from row to row
MODEL_MS = 0.35  # error of the delay from a non-exponential pixel response, in simulated recordings
LEAST_FRAMES, LEAST_FLIPS = (
    60,
    30,
)  # of 15 s at 15 Hz, a quarter; fewer leave several delays possible
OFF_BEAT, OFF_BEAT_SHARE = 0.25, 0.1  # of a period, and of all frames
LEAST_R, AREA_R, LEAST_R2 = (
    0.25,
    0.5,
    0.5,
)  # correlation of a pixel, as a share of the best pixel, squared of the bands
LEAST_PIXELS = 4  # of 64 across: a screen of a twentieth of the picture's height and width
SHORT = 0.1  # quantile: of steps from frame to frame, one period still; of holds, as a busy machine may cut a single one short
WIDEST_MS = 3.0  # half of the widest acceptable interval
# Camera and screen in step see the pattern at few phases of a refresh only; the rest comes from the model. This share of the
# phases that were never seen is added to the interval: of 16.7 ms, errors of up to 3.3 ms were measured.
IN_STEP_SHARE = 0.2
# Temporal noise reduction keeps a share of the frame before. Undoing such a share leaves at least 4 times as much unexplained if
# the camera keeps none, and at most half as much if it keeps a quarter or a half (simulated, 15 to 60 Hz).
MOST_AGAIN = 0.8  # some cameras deliver each frame twice or more; one that delivers the same always sees nothing
KEPT_SHARE, KEPT_RATIO = 0.35, 1.4  # between a quarter and a half; between a half and 4 times
SPAN = 0.12  # of the picture's height: allowed distance of the screen's middle from the picture's

Float = NDArray[np.float64]


@attrs.frozen
class Recording:
    """t_flip_ns: int64 (m,), times at which the screen presented another level; bright: bool (m,), that level. t_frame_ns: int64
    (n,), the camera's stamps. pictures: uint8 (n, height, width), small grey pictures. stamped: the stamps come from the driver,
    not from the time of reading. refresh_ms: period of the screen."""

    t_flip_ns: NDArray[np.int64]
    bright: NDArray[np.bool_]
    t_frame_ns: NDArray[np.int64]
    pictures: NDArray[np.uint8]
    stamped: bool
    refresh_ms: float

    def times_ms(self) -> tuple[Float, Float]:
        """Stamps and flips from the first flip on."""
        zero = self.t_flip_ns[0]
        return (self.t_frame_ns - zero) / 1e6, (self.t_flip_ns - zero) / 1e6

    @property
    def period_ms(self) -> float:
        """The camera's period, even if most of its frames are lost; infinite of stamps that do not rise."""
        steps = np.diff(self.t_frame_ns) / 1e6
        forward = steps[steps > 0]
        if not len(forward):
            return math.inf
        shortest = np.quantile(forward, SHORT)
        return float(np.median(forward / np.maximum(np.round(forward / shortest), 1)))

    def changes(self, levels: Float) -> Float:
        """levels (n, k) of the frames minus their running mean over SLOW_S."""
        n, half = len(levels), max(3, round(SLOW_S * 1e3 / self.period_ms)) // 2
        sums = np.concatenate([np.zeros((1, levels.shape[1])), np.cumsum(levels, axis=0)])
        low, high = np.maximum(np.arange(n) - half, 0), np.minimum(np.arange(n) + half + 1, n)
        means = (sums[high] - sums[low]) / (high - low)[:, None]
        return np.asarray(levels - means)


@attrs.frozen
class LoopDelay:
    """delay_ms with its 90 % interval. exposure_ms: as fitted."""

    delay_ms: float
    low_ms: float
    high_ms: float
    exposure_ms: float

    @property
    def half_ms(self) -> float:
        """Half of the interval."""
        return (self.high_ms - self.low_ms) / 2


def mean_light(recording: Recording, t_ms: Float, width_ms: float, response_ms: float) -> Float:
    """The screen's mean light, 0..1, within width_ms around each of t_ms. response_ms: of its pixels, which is exponential."""
    flips_ms, goal = recording.times_ms()[1], recording.bright.astype(float)
    gaps = np.diff(flips_ms)
    decay = np.exp(-gaps / response_ms)
    above = np.empty(len(flips_ms))  # light above its goal at each flip
    above[0] = 1.0 - 2.0 * goal[0]
    for j in range(len(gaps)):
        above[j + 1] = goal[j] + above[j] * decay[j] - goal[j + 1]
    before = np.concatenate(
        [[0.0], np.cumsum(goal[:-1] * gaps + above[:-1] * response_ms * (1 - decay))]
    )

    def integral(t_ms: Float) -> Float:
        at = np.clip(np.searchsorted(flips_ms, t_ms, "right") - 1, 0, None)
        since = np.maximum(t_ms - flips_ms[at], 0.0)
        return np.asarray(
            before[at] + goal[at] * since - above[at] * response_ms * np.expm1(-since / response_ms)
        )

    return (integral(t_ms + width_ms / 2) - integral(t_ms - width_ms / 2)) / width_ms


def _correlations(
    recording: Recording, levels: Float, delays_ms: Float, exposure_ms: float, response_ms: float
) -> Float:
    """How well k series of levels, (n, k), follow the pattern at each delay: float (delays, k), 0 not at all, 1 exactly."""
    seen = recording.changes(levels)
    seen /= np.maximum(
        np.linalg.norm(seen, axis=0), 1e-9 + 0.3 * np.sqrt(len(levels))
    )  # below 0.3 levels there is no signal
    # the response's mean is response_ms after the flip, and is part of the delay
    at_ms = recording.times_ms()[0][:, None] - (delays_ms - response_ms)
    light = mean_light(recording, at_ms, exposure_ms, response_ms)
    expected = recording.changes((np.clip(light, 0, 1) + STRAY) ** (1 / GAMMA))
    expected /= np.maximum(np.linalg.norm(expected, axis=0), 1e-9)
    return np.clip(expected.T @ seen, 0, 1)


def find_area(recording: Recording) -> tuple[Float, float]:
    """Correlation of each pixel with the pattern, float (height, width), at the best delay within half a frame; that delay in ms.
    Makes no decision: without a screen all correlations are small."""
    levels = recording.pictures.reshape(len(recording.pictures), -1).astype(float)
    delays = np.arange(*DELAYS_MS, COARSE_STEP_MS)
    tried = np.stack(
        [
            _correlations(recording, levels, delays, width, COARSE_RESPONSE_MS)
            for width in COARSE_EXPOSURES_MS
        ]
    )
    scores = np.square(tried).sum(axis=2)
    exposure, at = np.unravel_index(int(scores.argmax()), scores.shape)
    near = np.abs(delays - delays[at]) <= max(recording.period_ms / 2, COARSE_STEP_MS)
    return tried[exposure][near].max(axis=0).reshape(recording.pictures.shape[1:]), float(
        delays[at]
    )


@attrs.frozen(eq=False)
class Bands:
    """The screen in bands of rows. levels: (n, k), as the camera saw them. rows: (k,), their places in the picture, from -0.5 at
    its top to 0.5. weights: (k,). height: of the screen, as a share of the picture's."""

    levels: Float
    rows: Float
    weights: Float
    height: float

    @classmethod
    def of(cls, recording: Recording, weights: Float) -> Self:
        """weights: float (height, width), 0 outside the screen's area."""
        rows, height = np.nonzero(weights.any(axis=1))[0], len(weights)
        shares = [(band, weights[band]) for band in np.array_split(rows, min(BANDS, len(rows)))]
        masses = np.array([share.sum() for _, share in shares])
        levels = np.stack(
            [
                np.einsum("nhw,hw->n", recording.pictures[:, band].astype(float), share)
                for band, share in shares
            ],
            1,
        )
        places = (
            np.array([(share.sum(axis=1) * (band + 0.5)).sum() for band, share in shares])
            / masses
            / height
            - 0.5
        )
        return cls(levels / masses, places, masses, (rows[-1] + 1 - rows[0]) / height)

    @property
    def row(self) -> float:
        """The place of the screen's middle."""
        return float(np.average(self.rows, weights=self.weights))

    def explained(self, matches: Float) -> float:
        """R squared of the best model of each band."""
        return float(np.average(matches.max(axis=(0, 1)) ** 2, weights=self.weights))

    def unexplained(self, recording: Recording, matches: Float) -> float:
        """Mean square of what the best model leaves of each band's changes, levels squared."""
        return float(
            (np.square(recording.changes(self.levels)) * (1 - matches.max(axis=(0, 1)) ** 2)).mean()
        )


def _matches(recording: Recording, levels: Float, delays_ms: Float) -> Float:
    """`_correlations` with each of MODELS: float (models, delays, k)."""
    return np.stack(
        [
            _correlations(recording, levels, delays_ms, exposure_ms, tau_ms)
            for exposure_ms, tau_ms in MODELS
        ]
    )


def _fitted(bands: Bands, matches: Float, delays_ms: Float) -> tuple[LoopDelay, float]:
    """The posterior of the delay at the screen's middle row under a flat prior, over all models; and the time over the picture's
    height, ms, of the camera's readout minus the screen's own scan. matches: at delays_ms."""
    # bands share the errors of stamps: as independent as one band
    likelihoods = (
        -len(bands.levels) / 2 * np.log(1 - np.minimum(matches, 0.99999) ** 2) / len(bands.rows)
    )
    of_bands = delays_ms[likelihoods.max(axis=0).argmax(axis=0)]
    rows, middle_ms = bands.rows - bands.row, float(np.average(of_bands, weights=bands.weights))
    scan_ms = (
        -float(np.polyfit(rows, of_bands, 1, w=np.sqrt(bands.weights))[0]) if len(rows) > 1 else 0.0
    )
    grid = middle_ms + np.arange(-SEARCH_MS, SEARCH_MS, STEP_MS / 10)
    joint = np.zeros((len(matches), len(grid)))
    for band, row in enumerate(rows):
        joint += [
            np.interp(grid - scan_ms * row, delays_ms, of_model[:, band])
            for of_model in likelihoods
        ]
    chances = np.exp(joint - joint.max()).sum(axis=0)
    chances /= chances.sum()
    low_ms, high_ms = np.interp([0.05, 0.95], np.cumsum(chances), grid).tolist()
    return LoopDelay(
        float(chances @ grid), low_ms, high_ms, MODELS[int(joint.max(axis=1).argmax())][0]
    ), scan_ms


def estimate(recording: Recording) -> LoopDelay:
    """The delay of the loop. Raises UserError with the reason if this recording does not determine it."""
    recording = _checked(recording)
    r, coarse_ms = find_area(recording)
    area = (r > LEAST_R) & (r > AREA_R * r.max())
    if area.sum() < LEAST_PIXELS:
        raise UserError(
            "the camera does not see the pattern",
            "turn the camera to the screen, or hold a mirror before it, and dim the room",
        )
    bands, delays_ms = (
        Bands.of(recording, r * area),
        coarse_ms + np.arange(-NEAR_MS, NEAR_MS, STEP_MS),
    )
    matches = _matches(recording, bands.levels, delays_ms)
    if bands.explained(matches) < LEAST_R2:
        raise UserError(
            "the camera sees something like the pattern, but not clearly enough",
            "fill more of its picture with the screen, keep still, and dim the room",
        )
    delay, scan_ms = _fitted(bands, matches, delays_ms)
    if _mixes_frames(recording, bands, delay.delay_ms, bands.unexplained(recording, matches)):
        raise UserError(
            "the camera mixes each frame with the one before (temporal noise reduction), which hides its delay",
            "more light, and noise reduction off where `lfpipe cameras` lists such a control",
        )
    hold_ms = float(np.quantile(np.diff(recording.t_flip_ns), SHORT)) / 1e6
    if delay.exposure_ms > hold_ms:
        raise UserError(
            f"the exposure of {delay.exposure_ms:.0f} ms exceeds the pattern's hold of {hold_ms:.0f} ms",
            "more light, or a shorter exposure: --set camera.exposure=10",
        )
    if abs(bands.row) > SPAN:
        side = "above" if bands.row < 0 else "below"
        raise UserError(
            f"the screen is seen {side} the middle of the camera's picture",
            "aim the camera at the screen's middle",
        )
    # The camera's readout is the time from row to row and the screen's own scan, which is unknown: it takes up to a refresh for
    # the screen's visible height, and the camera up to a frame for its picture.
    readout_ms = max(0.0, scan_ms)
    longest_ms = max(
        readout_ms, min(scan_ms + recording.refresh_ms / bands.height, recording.period_ms)
    )
    shift = (readout_ms + longest_ms) / 2 * bands.row
    doubt = (
        abs(bands.row) * (longest_ms - readout_ms) / 2
        + MODEL_MS
        + IN_STEP_SHARE * _unseen_ms(recording)
    )
    low_ms, high_ms = delay.low_ms + shift - doubt, delay.high_ms + shift + doubt
    delay = LoopDelay(delay.delay_ms + shift, low_ms, high_ms, delay.exposure_ms)
    if delay.half_ms > WIDEST_MS:
        raise UserError(
            f"the delay is known no better than {delay.low_ms:.0f} to {delay.high_ms:.0f} ms: camera and screen run in step",
            "another rate of the camera or of the screen, for example --set camera.rate_hz=25",
        )
    return delay


def _mixes_frames(recording: Recording, bands: Bands, delay_ms: float, unexplained: float) -> bool:
    """Whether the recording is explained about as well by a camera that keeps a share of the frame before."""
    beats = np.diff(recording.t_frame_ns) / 1e6 / recording.period_ms
    kept = np.abs(beats - 1) < OFF_BEAT
    if kept.sum() < LEAST_FRAMES:
        return False
    undone = attrs.evolve(bands, levels=(bands.levels[1:] - KEPT_SHARE * bands.levels[:-1])[kept])
    other = attrs.evolve(
        recording, t_frame_ns=recording.t_frame_ns[1:][kept], pictures=recording.pictures[1:][kept]
    )
    delays_ms = np.arange(
        delay_ms - recording.period_ms - NEAR_MS / 2, delay_ms + NEAR_MS / 2, STEP_MS
    )
    return (
        undone.unexplained(other, _matches(other, undone.levels, delays_ms))
        < KEPT_RATIO * unexplained
    )


def _unseen_ms(recording: Recording) -> float:
    """The largest part of the flips' own step in which no frame was taken, by the camera's mean rate."""
    flips = np.diff(recording.t_flip_ns) / 1e6 / recording.refresh_ms
    step_ms = recording.refresh_ms * max(1, int(np.gcd.reduce(np.round(flips).astype(np.int64))))
    times, at_flips = recording.times_ms()
    numbers = np.round(times / recording.period_ms)
    even = np.polyval(
        np.polyfit(numbers, times, 1), numbers
    )  # without the jitter of stamps, which is no change of phase
    grid = np.round(at_flips / step_ms)
    slope, start = np.polyfit(grid, at_flips, 1)
    phases = np.sort((even - start) % slope)
    return float(np.max(np.diff(np.append(phases, phases[0] + slope))))


def _checked(recording: Recording) -> Recording:
    """The part of the recording that the pattern covers. Raises UserError if stamps or flips are unusable."""
    if not recording.stamped:
        raise UserError(
            "the frames have no stamps of the camera's driver",
            "another camera: nothing can be timed without",
        )
    visible = np.append(
        np.diff(recording.t_flip_ns) > 0, True
    )  # of two flips at one blank, the first was never seen
    recording = attrs.evolve(
        recording, t_flip_ns=recording.t_flip_ns[visible], bright=recording.bright[visible]
    )
    if len(recording.t_flip_ns) < LEAST_FLIPS:
        raise UserError(
            "the pattern was not presented",
            "keep the window in sight, and close what keeps the machine busy",
        )
    times, flips = recording.times_ms()
    kept = (times > DELAYS_MS[1]) & (times < flips[-1])
    if kept.sum() < LEAST_FRAMES:
        raise UserError(
            f"{kept.sum()} frames came of the camera while it should watch",
            "check the camera, and try again",
        )
    recording = attrs.evolve(
        recording, t_frame_ns=recording.t_frame_ns[kept], pictures=recording.pictures[kept]
    )
    beats = np.diff(recording.t_frame_ns) / 1e6 / recording.period_ms
    off = (beats <= 0) | (np.abs(beats - np.round(beats)) > OFF_BEAT)
    if off.mean() > OFF_BEAT_SHARE:
        raise UserError(
            f"the stamps of the camera's frames are irregular: {off.mean():.0%} of them are off their beat",
            "close what keeps the machine busy; where it stays so, another camera or another camera.format",
        )
    again = np.append(False, (recording.pictures[1:] == recording.pictures[:-1]).all(axis=(1, 2)))
    if again.mean() >= MOST_AGAIN:
        return recording
    return attrs.evolve(
        recording, t_frame_ns=recording.t_frame_ns[~again], pictures=recording.pictures[~again]
    )
