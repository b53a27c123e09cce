"""A made camera before a made screen that shows the calibration pattern: a Recording whose delay is known."""

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.observe.loop_delay import Recording

WIDTH_PX, HEIGHT_PX = 64, 48
FINE_MS = 0.1


@attrs.frozen
class Loop:
    """delay_ms: the truth. exposure_ms, readout_ms (first to last row): of the camera. scan_ms: first to last row of the screen.
    response_ms: 10 to 90 % of the pixels; shape: "exponential", "ramp", or "uneven": brighter takes twice as long as darker.
    gamma: of the camera. noise: levels, of a small picture's pixel. stamp_ms: jitter of stamps. off: middle of the screen from
    the middle of the picture, share of its height."""

    delay_ms: float = 60.0
    camera_hz: float = 30.0
    screen_hz: float = 60.0
    exposure_ms: float = 10.0
    response_ms: float = 4.0
    shape: str = "exponential"
    gamma: float = 2.2
    noise: float = 1.0
    readout_ms: float = 15.0
    scan_ms: float = 0.0
    stamp_ms: float = 0.2
    off: float = 0.0
    size: float = 0.5
    roll_deg: float = 5.0
    hidden: float = 0.2
    blur_px: float = 0.7
    duration_s: float = 15.0
    seed: int = 1


def drawn(rng: np.random.Generator, seed: int) -> Loop:
    """One of the loops of the 200 runs."""
    screen_hz, camera_hz = float(rng.choice([60, 75, 144])), float(rng.choice([15, 30, 60]))
    period_ms = 1e3 / camera_hz
    return Loop(
        delay_ms=rng.uniform(5, 150),
        camera_hz=camera_hz * (1 + rng.uniform(-3e-3, 3e-3)),
        screen_hz=screen_hz * (1 + rng.uniform(-1e-3, 1e-3)),
        exposure_ms=min(rng.uniform(2, 30), 0.95 * period_ms),
        response_ms=rng.uniform(0, 8),
        shape=str(rng.choice(["exponential", "ramp", "uneven"])),
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
    """When the screen flips, ms: holds of 3 to 6 refreshes of 60 Hz, longer in refreshes of a faster screen."""
    unit = max(1, round(loop.screen_hz / 60))
    holds = rng.integers(3, 7, int(loop.duration_s * loop.screen_hz)) * unit
    refreshes = np.cumsum(holds)
    times = refreshes * 1e3 / loop.screen_hz
    return np.asarray(times[times < loop.duration_s * 1e3])


def light(loop: Loop, at_ms: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The integral of the light on a grid of FINE_MS, and the mean of the response in ms, counted in the delay."""
    grid = np.arange(0, loop.duration_s * 1e3 + 1000, FINE_MS)
    level = (np.searchsorted(at_ms, grid, "right") % 2).astype(float)  # the first flip is to white
    mean_ms = 0.0
    if loop.response_ms > 0.05:
        if loop.shape == "ramp":
            count = max(1, round(loop.response_ms / 0.8 / FINE_MS))
            kernel = np.ones(count) / count
            level = np.convolve(level, kernel)[: len(grid)]
            mean_ms = (count - 1) / 2 * FINE_MS
        else:
            up_ms = loop.response_ms / 2.2 * (4 / 3 if loop.shape == "uneven" else 1)
            down_ms = loop.response_ms / 2.2 * (2 / 3 if loop.shape == "uneven" else 1)
            now, out = 0.0, np.empty_like(level)
            shares = {1.0: 1 - np.exp(-FINE_MS / up_ms), 0.0: 1 - np.exp(-FINE_MS / down_ms)}
            for k, goal in enumerate(level.tolist()):
                now += shares[goal] * (goal - now)
                out[k] = now
            level, mean_ms = out, (up_ms + down_ms) / 2
    return np.cumsum(level) * FINE_MS, mean_ms


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
    seen = ((u > loop.hidden) & (u < 1) & (v > 0) & (v < 1)).astype(
        np.float32
    )  # something stands before its left part
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

    def integrated(t_ms: NDArray[np.float64]) -> NDArray[np.float64]:
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
    levels = 255 * np.clip(linear, 0, 1) ** (1 / loop.gamma) + rng.normal(
        0, loop.noise, linear.shape
    )
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
