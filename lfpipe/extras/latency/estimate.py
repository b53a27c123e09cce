"""The device latency (camera and display together), from a camera's recording of a screen that
flips between black and white.

A frame with stamp t sees the screen's light, averaged over its exposure, as it was presented
`delay` earlier. The light of a flip rises and falls exponentially (pixel response). The delay runs
from the present to the middle of the exposure that sees it. It includes the mean of the response
and holds for the middle row of the camera's picture: rows above are read earlier, rows below later.

What the camera should see is computed for many delays, exposures and responses, and correlated with
what it saw, in each of some bands of rows. A short exposure in step with the screen sees only black
or white, and shows little of the time between: many delays then correlate equally well, and the
interval is wide.
"""

import itertools
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Self

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError


@attrs.frozen
class Model:
    """What a camera and a screen may be like."""

    exposure_ms: float
    rise_ms: float  # time constant of the screen's pixels, whose response is exponential
    fall_ms: float

    @property
    def response_ms(self) -> float:
        """The mean delay of the screen's light."""
        return (self.rise_ms + self.fall_ms) / 2


SLOW_S = 1.0  # slower changes come from ambient light and automatic exposure
DELAYS_MS = (-20.0, 480.0)  # searched; television sets with picture processing reach 350
# near enough to find the screen
COARSE_STEP_MS = 2.0
# around the coarse delay: half of the longest readout; half of the error that is allowed
NEAR_MS, STEP_MS = 30.0, 0.5
SEARCH_MS = 8.0  # around the best delay: an interval that reaches further is refused
# From exposures in bright light to twice the longest hold of the pattern; of pixels, from those of
# fast screens to twice those of slow ones. Finer steps gained nothing.
EXPOSURES_MS = tuple(np.geomspace(1.5, 100.0, 14).tolist())
RESPONSES_MS = (0.7, 3.0, 6.0, 9.5, 14.0)
MODELS = tuple(
    Model(*values) for values in itertools.product(EXPOSURES_MS, RESPONSES_MS, RESPONSES_MS)
)
MAX_MODELS = 48  # the likeliest, of which the delay is computed in fine steps
# Of a usual camera, and ambient light as a share of the screen's: where they are others, rises
# and falls of the light seem to be off in opposite directions, and the delay stays.
GAMMA, STRAY = 2.1, 0.05
BANDS = 6  # of rows: enough for the time from row to row
MODEL_MS = 0.35  # error of the delay from a non-exponential pixel response, in simulated recordings
# of 15 s at 15 Hz, a quarter; fewer leave several delays possible
MIN_FRAMES, MIN_FLIPS = 60, 30
OFF_BEAT, OFF_BEAT_SHARE = 0.25, 0.1  # of a period, and of all frames
# correlation of a pixel, as a share of the best pixel, squared of the bands
MIN_R, AREA_R, MIN_R2 = 0.25, 0.5, 0.5
MIN_CHANGE = 0.35  # of a pixel, as a share of the 98th percentile's
MIN_PIXELS = 4  # of 64 across: a screen of a twentieth of the picture's height and width
# quantile: of steps from frame to frame, one period still; of holds, as a busy machine may cut a
# single one short
SHORT = 0.1
# Error of the delay from a slow response that is not exponential: this share of what exceeds
RESPONSE_SHARE, RESPONSE_MS = 0.3, 3.0
WIDEST_MS = 3.0  # half of the widest acceptable interval
# Camera and screen in step see the pattern at few phases of a refresh only; the rest comes from the
# model. This share of the phases that were never seen is added to the interval: of 16.7 ms, errors
# of up to 3.3 ms were measured.
IN_STEP_SHARE = 0.2
# some cameras deliver each frame twice or more; one whose frames are all alike sees nothing
MAX_AGAIN = 0.8
# Temporal noise reduction keeps a share of the frame before. For simulated cameras that keep none,
# models that keep this share leave at least 1.17 times as much unexplained; for those that keep
# 0.15 or more, at most 0.93 times as much.
KEPT_SHARES, KEPT_RATIO = (0.1, 0.25), 1.05
# With a fast camera, a share of the frame before looks like a slow screen, and shifts the delay
# unnoticed: in simulated recordings by up to KEPT_MS where the models that keep a share leave less
# than SURE_RATIO times as much unexplained.
SURE_RATIO, KEPT_MS = 2.5, 1.8
# No exposure is longer than the camera's period, but a mean of two frames seems to be: a step of
# EXPOSURES_MS is 1.4.
LONGEST_EXPOSURE = 1.4  # periods
SPAN = 0.12  # of the picture's height: allowed distance of the screen's middle from the picture's

Float = NDArray[np.float64]


@attrs.frozen(kw_only=True)
class Recording:
    """What the camera saw while the screen changed its level."""

    t_flip_ns: NDArray[np.int64]
    """int64 (m,), times at which the screen presented another level."""
    bright: NDArray[np.bool_]
    """bool (m,), that level."""
    t_frame_ns: NDArray[np.int64]
    """int64 (n,), the camera's stamps."""
    pictures: NDArray[np.uint8]
    """uint8 (n, height, width), small grey pictures."""
    stamped: bool
    """The stamps come from the driver, not from the time of reading."""
    refresh_ms: float
    """Period of the screen."""

    def times_ms(self) -> tuple[Float, Float]:
        """Stamps and flips from the first flip on."""
        zero = self.t_flip_ns[0]
        return (self.t_frame_ns - zero) / 1e6, (self.t_flip_ns - zero) / 1e6

    @cached_property
    def period_ms(self) -> float:
        """The camera's period, even if most of its frames are lost; infinite for stamps that do not
        rise.
        """
        steps = np.diff(self.t_frame_ns) / 1e6
        forward = steps[steps > 0]
        if not len(forward):
            return math.inf
        shortest = np.quantile(forward, SHORT)
        return float(np.median(forward / np.maximum(np.round(forward / shortest), 1)))

    def changes(self, levels: Float) -> Float:
        """levels (n, k) of the frames minus their running mean over SLOW_S."""
        n = len(levels)
        half = max(3, round(SLOW_S * 1e3 / self.period_ms)) // 2
        sums = np.concatenate([np.zeros((1, levels.shape[1])), np.cumsum(levels, axis=0)])
        low = np.maximum(np.arange(n) - half, 0)
        high = np.minimum(np.arange(n) + half + 1, n)
        means = (sums[high] - sums[low]) / (high - low)[:, None]
        return np.asarray(levels - means)


@attrs.frozen
class LoopDelay:
    """The delay of camera and display together."""

    delay_ms: float
    low_ms: float
    high_ms: float
    """low_ms to high_ms is the 90 % interval of delay_ms."""
    exposure_ms: float
    """As fitted."""

    @property
    def half_ms(self) -> float:
        """Half of the interval."""
        return (self.high_ms - self.low_ms) / 2


def mean_light(recording: Recording, t_ms: Float, model: Model) -> Float:
    """The screen's mean light, 0..1, within an exposure around each of t_ms."""
    flips_ms = recording.times_ms()[1]
    goal = recording.bright.astype(float)
    gaps = np.diff(flips_ms)
    response_ms = np.where(recording.bright, model.rise_ms, model.fall_ms)
    decay = np.exp(-gaps / response_ms[:-1])
    above = np.empty(len(flips_ms))  # light above its goal at each flip
    above[0] = 1.0 - 2.0 * goal[0]
    for j in range(len(gaps)):
        above[j + 1] = goal[j] + above[j] * decay[j] - goal[j + 1]
    before = np.concatenate(
        [[0.0], np.cumsum(goal[:-1] * gaps + above[:-1] * response_ms[:-1] * (1 - decay))]
    )

    def integral(t_ms: Float) -> Float:
        at = np.clip(np.searchsorted(flips_ms, t_ms, "right") - 1, 0, None)
        since = np.maximum(t_ms - flips_ms[at], 0.0)
        late = above[at] * response_ms[at] * np.expm1(-since / response_ms[at])
        return np.asarray(before[at] + goal[at] * since - late)

    half_ms = model.exposure_ms / 2
    return (integral(t_ms + half_ms) - integral(t_ms - half_ms)) / model.exposure_ms


def _correlations(
    recording: Recording,
    levels: Float,
    delays_ms: Float,
    model: Model,
    kept: Sequence[float] = (0.0,),
) -> Float:
    """How well k series of levels, (n, k), follow the pattern at each delay, for each share of the
    frame before that the camera keeps: float (shares, delays, k), 0 not at all, 1 exactly.
    """
    seen = recording.changes(levels)
    # below 0.3 levels there is no signal
    seen /= np.maximum(np.linalg.norm(seen, axis=0), 1e-9 + 0.3 * np.sqrt(len(levels)))
    # the mean of the response is part of the delay
    at_ms = recording.times_ms()[0][:, None] - (delays_ms - model.response_ms)
    light = mean_light(recording, at_ms, model)
    frames = (np.clip(light, 0, 1) + STRAY) ** (1 / GAMMA)
    shares = np.array(kept)[:, None]
    mixed = np.repeat(frames[:, None], len(kept), axis=1)
    for frame, before in zip(mixed[1:], mixed[:-1], strict=True) if shares.any() else ():
        frame += shares * (before - frame)
    expected = recording.changes(mixed.reshape(len(mixed), -1))
    expected /= np.maximum(np.linalg.norm(expected, axis=0), 1e-9)
    found = (expected.T @ seen).reshape(len(kept), len(delays_ms), -1)
    return np.clip(found, 0, 1)


def find_area(recording: Recording) -> tuple[Float, float]:
    """Correlation of each pixel with the pattern, float (height, width), at the best delay within
    half a frame; that delay in ms.
    It makes no decision: if no screen is visible, all correlations are small.
    """
    levels = recording.pictures.reshape(len(recording.pictures), -1).astype(float)
    delays = np.arange(*DELAYS_MS, COARSE_STEP_MS)
    tried = np.stack(
        [
            _correlations(recording, levels, delays, Model(exposure_ms, 1.0, 1.0))[0]
            for exposure_ms in (4.0, 16.0, 33.0)
        ]
    )
    scores = np.square(tried).sum(axis=2)
    exposure, at = np.unravel_index(int(scores.argmax()), scores.shape)
    near = np.abs(delays - delays[at]) <= max(recording.period_ms / 2, COARSE_STEP_MS)
    r = tried[exposure][near].max(axis=0)
    # What only automatic exposure brightens and darkens follows the pattern, too, but later.
    sizes = recording.changes(levels).std(axis=0)
    r[sizes < MIN_CHANGE * np.quantile(sizes, 0.98)] = 0
    return r.reshape(recording.pictures.shape[1:]), float(delays[at])


@attrs.frozen(eq=False)
class Bands:
    """The screen in bands of rows."""

    levels: Float
    """(n, k), as the camera saw them."""
    rows: Float
    """(k,), their places in the picture, from -0.5 at its top to 0.5."""
    weights: Float
    """(k,)."""
    height: float
    """Of the screen, as a share of the picture's."""

    @classmethod
    def of(cls, recording: Recording, weights: Float) -> Self:
        """weights: float (height, width), 0 outside the screen's area."""
        rows = np.nonzero(weights.any(axis=1))[0]
        height = len(weights)
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
        return cls(levels / masses, places, masses, float(rows[-1] + 1 - rows[0]) / height)

    @property
    def row(self) -> float:
        """The place of the screen's middle."""
        return float(np.average(self.rows, weights=self.weights))

    def mean(self) -> Float:
        """The levels of all bands together, (n, 1)."""
        return np.average(self.levels, axis=1, weights=self.weights)[:, None]

    def explained(self, matches: Float) -> float:
        """R squared of the best model of each band."""
        return float(np.average(matches.max(axis=(0, 1)) ** 2, weights=self.weights))


def _matches(
    recording: Recording,
    levels: Float,
    delays_ms: Float,
    models: Sequence[Model],
    kept: Sequence[float] = (0.0,),
) -> Float:
    """`_correlations` with each of the models: float (shares, models, delays, k)."""
    return np.stack(
        [_correlations(recording, levels, delays_ms, model, kept) for model in models], axis=1
    )


def _fitted(
    bands: Bands, matches: Float, delays_ms: Float, models: Sequence[Model]
) -> tuple[LoopDelay, float]:
    """The posterior of the delay at the screen's middle row under a flat prior, over all models;
    and the time over the picture's height, ms, of the camera's readout minus the screen's own scan.
    matches: at delays_ms.
    """
    # bands share the errors of stamps: as independent as one band
    likelihoods = (
        -len(bands.levels) / 2 * np.log(1 - np.minimum(matches, 0.99999) ** 2) / len(bands.rows)
    )
    of_bands = delays_ms[likelihoods.max(axis=0).argmax(axis=0)]
    rows = bands.rows - bands.row
    middle_ms = float(np.average(of_bands, weights=bands.weights))
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
    best = models[int(joint.max(axis=1).argmax())]
    doubt_ms = RESPONSE_SHARE * max(0.0, best.response_ms - RESPONSE_MS)
    delay_ms = float(chances @ grid)
    return LoopDelay(delay_ms, low_ms - doubt_ms, high_ms + doubt_ms, best.exposure_ms), scan_ms


def estimate(recording: Recording) -> LoopDelay:
    """The delay of the loop.

    Raises UserError with the reason if this recording does not determine it.
    """
    recording = _checked(recording)
    r, coarse_ms = find_area(recording)
    area = (r > MIN_R) & (r > AREA_R * r.max())
    if area.sum() < MIN_PIXELS:
        raise UserError(
            "the camera does not see the pattern",
            "point the camera at the screen, or hold a mirror in front of it, and dim the room",
        )
    bands = Bands.of(recording, r * area)
    mean = bands.mean()
    delays_ms = coarse_ms + np.arange(-NEAR_MS, NEAR_MS, COARSE_STEP_MS)
    tried = _matches(recording, mean, delays_ms, MODELS, (0.0, *KEPT_SHARES))
    scores = tried[0].max(axis=(1, 2))
    mixed = tried[1:].max()
    models = [MODELS[k] for k in np.argsort(scores)[-MAX_MODELS:]]
    delays_ms = coarse_ms + np.arange(-NEAR_MS, NEAR_MS, STEP_MS)
    matches = _matches(recording, bands.levels, delays_ms, models)[0]
    if bands.explained(matches) < MIN_R2:
        raise UserError(
            "the camera sees something like the pattern, but not clearly enough",
            "fill more of its picture with the screen, keep still, and dim the room",
        )
    delay, scan_ms = _fitted(bands, matches, delays_ms, models)
    if abs(bands.row) > SPAN:
        side = "above" if bands.row < 0 else "below"
        raise UserError(
            f"the screen is seen {side} the middle of the camera's picture",
            "aim the camera at the screen's middle",
        )
    in_step_ms = IN_STEP_SHARE * _unseen_ms(recording)
    if in_step_ms > WIDEST_MS:
        raise _in_step(delay.low_ms - in_step_ms, delay.high_ms + in_step_ms)
    hold_ms = float(np.quantile(np.diff(recording.t_flip_ns), SHORT)) / 1e6
    averages = delay.exposure_ms > LONGEST_EXPOSURE * recording.period_ms
    if delay.exposure_ms > hold_ms and not averages:
        raise UserError(
            f"the exposure of {delay.exposure_ms:.0f} ms exceeds the pattern's hold of"
            f" {hold_ms:.0f} ms",
            "add light, or shorten the exposure: --set camera.exposure=10",
        )
    ratio = (1 - mixed**2) / max(1 - scores.max() ** 2, 1e-9)
    if averages or ratio < KEPT_RATIO:
        raise _mixed()
    kept_ms = 0.0
    if recording.period_ms < 2 * RESPONSES_MS[-1]:
        kept_ms = KEPT_MS * max(0.0, (SURE_RATIO - ratio) / (SURE_RATIO - KEPT_RATIO))
    # The camera's readout is the time from row to row and the screen's own scan, which is unknown:
    # it takes up to a refresh for the screen's visible height,
    # and the camera up to a frame for its picture.
    readout_ms = max(0.0, scan_ms)
    longest_ms = max(
        readout_ms, min(scan_ms + recording.refresh_ms / bands.height, recording.period_ms)
    )
    shift = (readout_ms + longest_ms) / 2 * bands.row
    doubt = abs(bands.row) * (longest_ms - readout_ms) / 2 + MODEL_MS + in_step_ms + kept_ms
    low_ms = delay.low_ms + shift - doubt
    high_ms = delay.high_ms + shift + doubt
    delay = LoopDelay(delay.delay_ms + shift, low_ms, high_ms, delay.exposure_ms)
    if delay.half_ms > WIDEST_MS:
        raise _mixed() if kept_ms > in_step_ms else _in_step(low_ms, high_ms)
    return delay


def _mixed() -> UserError:
    return UserError(
        "the camera mixes each frame with the one before (temporal noise reduction), or the"
        " screen is very slow: either hides the delay",
        "add light, and turn noise reduction off if `lfpipe cameras` lists such a control",
    )


def _in_step(low_ms: float, high_ms: float) -> UserError:
    return UserError(
        f"the delay is known no better than {low_ms:.0f} to {high_ms:.0f} ms:"
        " camera and screen run in step",
        "change the rate of the camera or of the screen, for example --set camera.rate_hz=25",
    )


def _unseen_ms(recording: Recording) -> float:
    """The largest part of the flips' own step in which no frame was taken, by the camera's mean
    rate.
    """
    flips = np.diff(recording.t_flip_ns) / 1e6 / recording.refresh_ms
    step_ms = recording.refresh_ms * max(1, int(np.gcd.reduce(np.round(flips).astype(np.int64))))
    times, at_flips = recording.times_ms()
    # from frame to frame: over a whole recording, the error of the period adds up to frames
    numbers = np.cumsum(np.round(np.diff(times, prepend=times[0]) / recording.period_ms))
    # without the jitter of stamps, which is no change of phase
    even = np.polyval(np.polyfit(numbers, times, 1), numbers)
    grid = np.round(at_flips / step_ms)
    slope, start = np.polyfit(grid, at_flips, 1)
    phases = np.sort((even - start) % slope)
    return float(np.max(np.diff(np.append(phases, phases[0] + slope))))


def _checked(recording: Recording) -> Recording:
    """The part of the recording that the pattern covers.

    Raises UserError if stamps or flips are unusable.
    """
    if not recording.stamped:
        raise UserError(
            "the camera's driver does not stamp the frames",
            "use another camera: only its driver knows when a frame was exposed",
        )
    # of two flips at one vblank, the first was never seen
    visible = np.diff(recording.t_flip_ns, append=np.iinfo(np.int64).max) > 0
    recording = attrs.evolve(
        recording, t_flip_ns=recording.t_flip_ns[visible], bright=recording.bright[visible]
    )
    if len(recording.t_flip_ns) < MIN_FLIPS:
        raise UserError(
            "the pattern was not presented",
            "keep the window in sight, and close what keeps the machine busy",
        )
    times, flips = recording.times_ms()
    kept = (times > DELAYS_MS[1]) & (times < flips[-1])
    if kept.sum() < MIN_FRAMES:
        raise UserError(
            f"the camera delivered only {kept.sum()} frames while the pattern was shown",
            "check the camera's cable and light, and try again",
        )
    recording = attrs.evolve(
        recording, t_frame_ns=recording.t_frame_ns[kept], pictures=recording.pictures[kept]
    )
    beats = np.diff(recording.t_frame_ns) / 1e6 / recording.period_ms
    off = (beats <= 0) | (np.abs(beats - np.round(beats)) > OFF_BEAT)
    if off.mean() > OFF_BEAT_SHARE:
        raise UserError(
            f"the stamps of the camera's frames are irregular: {off.mean():.0%} of them are off"
            " their beat",
            "close what keeps the machine busy; if that does not help, try another camera.format or"
            " another camera",
        )
    again = np.append(False, (recording.pictures[1:] == recording.pictures[:-1]).all(axis=(1, 2)))
    if again.mean() >= MAX_AGAIN:
        return recording
    return attrs.evolve(
        recording, t_frame_ns=recording.t_frame_ns[~again], pictures=recording.pictures[~again]
    )
