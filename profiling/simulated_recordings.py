"""A simulated camera in front of a simulated screen with the calibration pattern: a Recording whose
delay is known.
"""

import math
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.extras.latency.estimate import Recording

WIDTH_PX, HEIGHT_PX = 64, 48
FINE_MS = 0.1


@attrs.frozen(kw_only=True)
class Loop:
    """A camera before a screen.

    Shapes of the screen's response: "exponential", "ramp" (constant speed) or "s-curve" (starts and
    ends slowly).
    """

    delay_ms: float = 60.0  # the truth
    camera_hz: float = 30.0
    screen_hz: float = 60.0
    exposure_ms: float = 10.0
    rise_ms: float = 4.0  # of the pixels, from 10 to 90 %
    fall_ms: float = 4.0  # from 90 to 10 %
    shape: str = "exponential"
    overdrive: float = 0.0  # share by which a change overshoots
    gamma: float = 2.2  # of the camera
    noise: float = 1.0  # levels, of a small picture's pixel
    readout_ms: float = 15.0  # of the camera, from its first row to its last
    scan_ms: float = 0.0  # of the screen, from its first row to its last
    stamp_ms: float = 0.2  # jitter of stamps
    gain_share: float = (
        0.0  # of the error of the mean level that automatic exposure removes a frame
    )
    kept: float = (
        0.0  # share of the frame before that noise reduction keeps; -1: mean of two frames
    )
    off: float = 0.0  # middle of the screen from the middle of the picture, share of its height
    size: float = 0.5  # width of the screen, share of the picture's
    roll_deg: float = 5.0
    hidden: float = 0.2
    blur_px: float = 0.7
    duration_s: float = 15.0
    seed: int = 1


def drawn(rng: np.random.Generator, seed: int) -> Loop:
    """One of the loops of the 200 runs."""
    screen_hz, camera_hz = float(rng.choice([60, 75, 144])), float(rng.choice([15, 30, 60]))
    period_ms = 1e3 / camera_hz
    delay_ms = rng.uniform(5, 150)
    camera_hz *= 1 + rng.uniform(-3e-3, 3e-3)
    screen_true_hz = screen_hz * (1 + rng.uniform(-1e-3, 1e-3))
    exposure_ms = min(rng.uniform(2, 30), 0.95 * period_ms)
    response_ms = rng.uniform(0, 8)
    shape = str(rng.choice(["exponential", "ramp", "uneven"]))
    uneven = shape == "uneven"  # brighter takes twice as long as darker
    return Loop(
        delay_ms=delay_ms,
        camera_hz=camera_hz,
        screen_hz=screen_true_hz,
        exposure_ms=exposure_ms,
        rise_ms=response_ms * (4 / 3 if uneven else 1),
        fall_ms=response_ms * (2 / 3 if uneven else 1),
        shape="exponential" if uneven else shape,
        gamma=rng.uniform(1.8, 2.4),
        noise=rng.uniform(0.3, 3),
        readout_ms=rng.uniform(0, 0.9) * min(period_ms, 30),
        scan_ms=float(rng.choice([0.0, 0.95])) * 1e3 / screen_hz,
        stamp_ms=rng.uniform(0, 0.3),
        off=rng.uniform(-0.04, 0.04),
        size=rng.uniform(0.25, 0.8),
        roll_deg=rng.uniform(-15, 15),
        hidden=rng.uniform(0, 0.4),
        blur_px=rng.uniform(0, 1.5),
        seed=seed,
    )


def flips(loop: Loop, rng: np.random.Generator) -> NDArray[np.float64]:
    """When the screen flips, ms: holds of 3 to 6 refreshes of 60 Hz, longer in refreshes of a
    faster screen.
    """
    unit = max(1, round(loop.screen_hz / 60))
    holds = rng.integers(3, 7, int(loop.duration_s * loop.screen_hz)) * unit
    refreshes = np.cumsum(holds)
    times = refreshes * 1e3 / loop.screen_hz
    return np.asarray(times[times < loop.duration_s * 1e3])


def light(loop: Loop, at_ms: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The integral of the light on a grid of FINE_MS, and the mean delay of the response in ms: of
    a rise and a fall, by the light that they bring late.
    """
    grid = np.arange(0, loop.duration_s * 1e3 + 1000, FINE_MS)
    level = (np.searchsorted(at_ms, grid, "right") % 2).astype(float)  # the first flip is to white
    step = np.repeat([0.0, 1.0, 0.0], round(500 / FINE_MS))
    single = _responded(loop, step)
    rise_ms = float((1 - single[len(step) // 3 : 2 * len(step) // 3]).sum()) * FINE_MS
    fall_ms = float(single[2 * len(step) // 3 :].sum()) * FINE_MS
    return np.cumsum(_responded(loop, level)) * FINE_MS, (rise_ms + fall_ms) / 2


def _responded(loop: Loop, goals: NDArray[np.float64]) -> NDArray[np.float64]:
    """The light of pixels that should have the levels `goals`, on a grid of FINE_MS."""
    stages = {"exponential": 1, "s-curve": 2, "ramp": 0}[loop.shape]
    # 10 to 90 % take 2.2 time constants of one stage, 3.36 of two
    constants_ms = {1.0: loop.rise_ms, 0.0: loop.fall_ms}
    out = goals
    for _ in range(stages):
        per_ms = {1: 2.197, 2: 3.358}[stages]
        shares = {
            goal: 1 - math.exp(-FINE_MS * per_ms / max(ms, 1e-3))
            for goal, ms in constants_ms.items()
        }
        now = 0.0
        followed = np.empty_like(out)
        for k, (level, goal) in enumerate(zip(out.tolist(), goals.tolist(), strict=True)):
            now += shares[goal] * (level - now)
            followed[k] = now
        out = followed
    if stages == 0:
        speeds = {goal: FINE_MS * 0.8 / max(ms, 1e-3) for goal, ms in constants_ms.items()}
        now = 0.0
        out = np.empty_like(goals)
        for k, goal in enumerate(goals.tolist()):
            now += min(max(goal - now, -speeds[goal]), speeds[goal])
            out[k] = now
    if loop.overdrive:
        out = out + loop.overdrive * (goals - _lagged(goals, 6.0)) * np.abs(out - _lagged(out, 6.0))
    return out


def _lagged(levels: NDArray[np.float64], tau_ms: float) -> NDArray[np.float64]:
    """levels behind an exponential low-pass."""
    share = 1 - math.exp(-FINE_MS / tau_ms)
    out = np.empty_like(levels)
    now = 0.0
    for k, level in enumerate(levels.tolist()):
        now += share * (level - now)
        out[k] = now
    return out


def geometry(
    loop: Loop, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """How much of the screen each pixel sees, 0..1, and from which row of it, 0..1 from its top."""
    fine = 4
    w, h = WIDTH_PX * fine, HEIGHT_PX * fine
    half = np.array([loop.size * w / 2, loop.size * w / 2 * 9 / 16])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half * rng.uniform(0.85, 1.0, (4, 1))
    turn = np.radians(loop.roll_deg)
    corners = corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    corners += (w / 2 + rng.uniform(-0.1, 0.1) * w, h * (0.5 + loop.off))
    corners = corners.astype(np.float32)
    matrix = cv2.getPerspectiveTransform(
        corners, np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    )
    y, x = np.mgrid[0:h, 0:w] + 0.5
    u, v, scale = np.einsum("ij,jhw->ihw", matrix, np.stack([x, y, np.ones_like(x)]))
    u, v = u / scale, v / scale
    # something stands before its left part
    seen = ((u > loop.hidden) & (u < 1) & (v > 0) & (v < 1)).astype(np.float32)
    cover = cv2.resize(seen, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
    if loop.blur_px > 0.1:
        cover = cv2.GaussianBlur(cover, (0, 0), loop.blur_px)
    rows = cv2.resize(
        np.clip(v, 0, 1).astype(np.float32), (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA
    )
    return np.asarray(cover), np.asarray(rows)


def recording(loop: Loop) -> Recording:
    """What the camera sees."""
    rng = np.random.default_rng(loop.seed)
    at_ms = flips(loop, rng)
    integral, mean_ms = light(loop, at_ms)
    cover, rows = geometry(loop, rng)
    period_ms = 1e3 / loop.camera_hz
    true_ms = (
        rng.uniform(0, period_ms) + np.arange(int(loop.duration_s * 1e3 / period_ms)) * period_ms
    )
    down = (np.arange(HEIGHT_PX) + 0.5) / HEIGHT_PX - 0.5
    late = loop.readout_ms * down[:, None] - loop.scan_ms * (rows - 0.5)
    middle = true_ms[:, None, None] - (loop.delay_ms - mean_ms) + late

    def integrated(t_ms: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        at = np.clip(t_ms / FINE_MS - 1, 0, len(integral) - 2)
        low = at.astype(np.int64)
        return np.asarray(integral[low] + (at - low) * (integral[low + 1] - integral[low]))

    seen = (
        integrated(middle + loop.exposure_ms / 2) - integrated(middle - loop.exposure_ms / 2)
    ) / loop.exposure_ms
    ambient = cv2.GaussianBlur(
        rng.uniform(0, 0.4, (HEIGHT_PX, WIDTH_PX)), (0, 0), 2.0
    ) * rng.uniform(0.1, 1.0)
    gain = 1 + 0.08 * np.sin(true_ms / 1e3 / 3)[:, None, None]  # automatic exposure
    linear = gain * (ambient + cover * (0.01 + 0.6 * seen))
    if loop.gain_share:
        linear = _exposed(linear / gain, loop)
    levels = 255 * np.clip(linear, 0, 1) ** (1 / loop.gamma) + rng.normal(
        0, loop.noise, linear.shape
    )
    if loop.kept < 0:
        levels[1:] = (levels[1:] + levels[:-1]) / 2
    for k in range(1, len(levels) if loop.kept > 0 else 0):
        levels[k] += loop.kept * (levels[k - 1] - levels[k])
    zero_ns = 10**12
    stamps_ms = true_ms + rng.normal(0, loop.stamp_ms, len(true_ms))
    return Recording(
        t_flip_ns=zero_ns + np.round(at_ms * 1e6).astype(np.int64),
        bright=np.arange(len(at_ms)) % 2 == 0,
        t_frame_ns=zero_ns + np.round(stamps_ms * 1e6).astype(np.int64),
        pictures=np.clip(np.round(levels), 0, 255).astype(np.uint8),
        stamped=True,
        refresh_ms=1e3 / loop.screen_hz,
    )


def _exposed(linear: NDArray[np.float64], loop: Loop) -> NDArray[np.float64]:
    """linear (n, height, width) with the gain of an automatic exposure that aims at the mean level
    of the first second.
    """
    goal = float(np.mean(np.clip(linear[: round(loop.camera_hz)], 0, 1) ** (1 / loop.gamma)))
    gain = 1.0
    out = np.empty_like(linear)
    for k, frame in enumerate(linear):
        out[k] = gain * frame
        mean = float(np.mean(np.clip(out[k], 0, 1) ** (1 / loop.gamma)))
        gain *= (1 + loop.gain_share * (goal - mean) / goal) ** loop.gamma
    return out
