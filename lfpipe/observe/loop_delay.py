"""The delay of the loop (camera and display together), from a camera's recording of a screen that flips between black and white.

A frame with stamp t sees the screen's light, averaged over its exposure, as it was presented `delay` earlier. The light of a flip
rises and falls exponentially (pixel response). The delay runs from the present to the middle of the exposure that sees it. It
includes the mean of the response and holds for the middle row of the camera's picture: rows above are read earlier, rows below
later.
"""

from operator import attrgetter

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.observe.loop_fit import SLOW_S, Float, LoopFit, Recording, ScreenLight, times_ms, without_slow

DELAYS_MS = (-20.0, 480.0)  # searched; television sets with picture processing reach 350
COARSE_STEP_MS, COARSE_EXPOSURES_MS = 2.0, (4.0, 16.0, 33.0)  # near enough for the fit, which refines them
LEAST_FRAMES, LEAST_FLIPS = 60, 30  # of 15 s at 15 Hz, a quarter; fewer leave several delays possible
OFF_BEAT, OFF_BEAT_SHARE = 0.25, 0.1  # of a period, and of all frames
LEAST_R, AREA_R, LEAST_R2 = 0.25, 0.5, 0.5  # correlation of a pixel, as a share of the best pixel, and of the fit
LEAST_PIXELS = 4  # of 64 across: a screen of a twentieth of the picture's height and width
SHORT_STEP = 0.1  # quantile of the steps from frame to frame that is of one period still
SHORT_HOLD = 0.1  # quantile: a busy machine may cut a single hold short
WIDEST_MS = 3.0  # half of the widest acceptable interval
# Camera and screen in step see the pattern at few phases of a refresh only; the rest comes from the model. This share of the
# phases that were never seen is added to the interval: of 16.7 ms, errors of up to 3.3 ms were measured.
IN_STEP_SHARE = 0.2
# Temporal noise reduction keeps a share of the frame before. Undoing such a share fits worse by at least 25 times if the camera
# keeps none, and by at most 1.5 times if it keeps a quarter or a half (simulated, 15 to 60 Hz).
MOST_AGAIN = 0.8  # some cameras deliver each frame twice or more; one that delivers the same always sees nothing
KEPT_SHARE, KEPT_RATIO = 0.35, 2.0  # between a quarter and a half; between 1.5 and 25 times
SPAN = 0.12  # of the picture's height: allowed distance of the screen's middle from the picture's


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


def find_area(recording: Recording) -> tuple[NDArray[np.float64], float, float]:
    """Correlation of each pixel with the pattern, float (height, width), at the best delay within half a frame; that delay and
    the best exposure in ms. Makes no decision: without a screen all correlations are small."""
    times, flips = times_ms(recording)
    period = float(np.median(np.diff(times)))
    slow = max(3, round(SLOW_S * 1e3 / period))
    seen = without_slow(recording.pictures.reshape(len(times), -1).astype(float), slow)
    seen /= np.maximum(np.linalg.norm(seen, axis=0), 1e-9 + 0.3 * np.sqrt(len(times)))  # below 0.3 levels there is no signal
    delays = np.arange(*DELAYS_MS, COARSE_STEP_MS)
    light = ScreenLight(flips, recording.bright, 1.0)
    correlations = []  # for each exposure: float (delays, pixels)
    for width in COARSE_EXPOSURES_MS:
        looks = without_slow(light.mean(times[:, None] - delays, width), slow)
        correlations.append((looks / np.maximum(np.linalg.norm(looks, axis=0), 1e-9)).T @ seen)
    scores = np.stack([np.square(np.maximum(r, 0)).sum(axis=1) for r in correlations])
    exposure, at = np.unravel_index(int(scores.argmax()), scores.shape)
    near = np.abs(delays - delays[at]) <= max(period / 2, COARSE_STEP_MS)
    area = correlations[exposure][near].max(axis=0).reshape(recording.pictures.shape[1:])
    return area, float(delays[at]), COARSE_EXPOSURES_MS[exposure]


def estimate(recording: Recording) -> LoopDelay:
    """The delay of the loop. Raises UserError with the reason if this recording does not determine it."""
    recording = _checked(recording)
    r, coarse_ms, width_ms = find_area(recording)
    area = (r > LEAST_R) & (r > AREA_R * r.max())
    if area.sum() < LEAST_PIXELS:
        raise UserError(
            "the camera does not see the pattern", "turn the camera to the screen, or hold a mirror before it, and dim the room"
        )
    fit = LoopFit(recording, r * area)
    solution = min((fit.solved(coarse_ms + step, width_ms) for step in (-8.0, 0.0, 8.0)), key=attrgetter("cost"))
    for width in (2.0, 25.0, 80.0):
        solution = min(solution, fit.solved(solution.vector[0], width), key=attrgetter("cost"))
    best = solution.vector
    if fit.explained(best) < LEAST_R2:
        raise UserError(
            "the camera sees something like the pattern, but not clearly enough",
            "fill more of its picture with the screen, keep still, and dim the room",
        )
    exposure_ms, hold_ms = float(np.exp(best[2])), float(np.quantile(np.diff(recording.t_flip_ns), SHORT_HOLD)) / 1e6
    if exposure_ms > hold_ms:
        raise UserError(
            f"the exposure of {exposure_ms:.0f} ms exceeds the pattern's hold of {hold_ms:.0f} ms",
            "more light, or a shorter exposure: --set camera.exposure=10",
        )
    if _mixes_frames(recording, r * area, fit, best):
        raise UserError(
            "the camera mixes each frame with the one before (temporal noise reduction), which hides its delay",
            "more light, and noise reduction off where `lfpipe cameras` lists such a control",
        )
    low, middle, high = fit.interval(best)
    shift, doubt = fit.to_middle_row(best, recording.refresh_ms)
    doubt += IN_STEP_SHARE * _unseen_ms(recording)
    delay = LoopDelay(middle + shift, low + shift - doubt, high + shift + doubt, exposure_ms)
    if abs(fit.row) > SPAN:
        side = "above" if fit.row < 0 else "below"
        raise UserError(f"the screen is seen {side} the middle of the camera's picture", "aim the camera at the screen's middle")
    if delay.half_ms > WIDEST_MS:
        raise UserError(
            f"the delay is known no better than {delay.low_ms:.0f} to {delay.high_ms:.0f} ms: camera and screen run in step",
            "another rate of the camera or of the screen, for example --set camera.rate_hz=25",
        )
    return delay


def _mixes_frames(recording: Recording, weights: Float, fit: LoopFit, best: Float) -> bool:
    """Whether the recording is explained about as well by a camera that keeps a share of the frame before."""
    steps = np.diff(recording.t_frame_ns)
    next_frame = np.append(False, np.abs(steps / np.median(steps) - 1) < OFF_BEAT)
    pictures = recording.pictures.astype(np.float32)
    undone = (pictures[1:] - KEPT_SHARE * pictures[:-1]) / (1 - KEPT_SHARE)
    kept = next_frame[1:]
    if kept.sum() < LEAST_FRAMES:
        return False
    other = LoopFit(attrs.evolve(recording, t_frame_ns=recording.t_frame_ns[1:][kept], pictures=undone[kept]), weights)
    period_ms = float(np.median(steps)) / 1e6
    starts = (other.solved(best[0] - late * period_ms, float(np.exp(best[2]))) for late in (0.0, 0.35, 0.7))
    solved = min(starts, key=attrgetter("cost")).vector
    return other.unexplained(solved) * (1 - KEPT_SHARE) ** 2 < KEPT_RATIO * fit.unexplained(best)


def _unseen_ms(recording: Recording) -> float:
    """The largest part of the flips' own step in which no frame was taken, by the camera's mean rate."""
    flips = np.diff(recording.t_flip_ns) / 1e6 / recording.refresh_ms
    step_ms = recording.refresh_ms * max(1, int(np.gcd.reduce(np.round(flips).astype(np.int64))))
    times, at_flips = times_ms(recording)
    numbers = np.round(times / _period_ms(np.diff(times)))
    even = np.polyval(np.polyfit(numbers, times, 1), numbers)  # without the jitter of stamps, which is no change of phase
    grid = np.round(at_flips / step_ms)
    slope, start = np.polyfit(grid, at_flips, 1)
    phases = np.sort((even - start) % slope)
    return float(np.max(np.diff(np.append(phases, phases[0] + slope))))


def _period_ms(steps: Float) -> float:
    """The period of a camera from the steps between its frames, even if it loses most of them."""
    forward = steps[steps > 0]
    if not len(forward):
        return float("nan")
    shortest = np.quantile(forward, SHORT_STEP)
    return float(np.median(forward / np.maximum(np.round(forward / shortest), 1)))


def _checked(recording: Recording) -> Recording:
    """The part of the recording that the pattern covers. Raises UserError if stamps or flips are unusable."""
    if not recording.stamped:
        raise UserError("the frames have no stamps of the camera's driver", "another camera: nothing can be timed without")
    visible = np.append(np.diff(recording.t_flip_ns) > 0, True)  # of two flips at one blank, the first was never seen
    recording = attrs.evolve(recording, t_flip_ns=recording.t_flip_ns[visible], bright=recording.bright[visible])
    if len(recording.t_flip_ns) < LEAST_FLIPS:
        raise UserError("the pattern was not presented", "keep the window in sight, and close what keeps the machine busy")
    times, flips = times_ms(recording)
    kept = (times > DELAYS_MS[1]) & (times < flips[-1])
    if kept.sum() < LEAST_FRAMES:
        raise UserError(f"{kept.sum()} frames came of the camera while it should watch", "check the camera, and try again")
    steps = np.diff(times[kept])
    beats = steps / _period_ms(steps)
    off = (steps <= 0) | (np.abs(beats - np.round(beats)) > OFF_BEAT)
    if off.mean() > OFF_BEAT_SHARE:
        raise UserError(
            f"the stamps of the camera's frames are irregular: {off.mean():.0%} of them are off their beat",
            "close what keeps the machine busy; where it stays so, another camera or another camera.format",
        )
    again = np.append(False, (recording.pictures[1:] == recording.pictures[:-1]).all(axis=(1, 2)))
    if again.mean() < MOST_AGAIN:
        kept &= ~again
    return attrs.evolve(recording, t_frame_ns=recording.t_frame_ns[kept], pictures=recording.pictures[kept])
