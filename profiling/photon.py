"""How well the delay of the loop is found: made cameras before made screens, and recordings that must be refused.

`python -m profiling.photon [--runs N]` prints the table of profiling/results/photon.md.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import attrs
import cv2
import numpy as np

from lfpipe.errors import UserError
from lfpipe.observe.loop_delay import LoopDelay, Recording, estimate

sys.path.insert(0, str(Path(__file__).parents[1]))

from profiling.photon_simulation import Loop, drawn, recording


def bad_recordings(duration_s: float = 15.0) -> Iterator[tuple[str, str, Recording]]:
    """(what is wrong, word that the refusal must hold, recording): 20 of them."""
    good = recording(Loop(duration_s=duration_s))
    rng = np.random.default_rng(7)
    shape = good.pictures.shape

    def with_pictures(levels: np.ndarray) -> Recording:
        return attrs.evolve(good, pictures=np.clip(np.round(levels), 0, 255).astype(np.uint8))

    yield "a dark lens", "not see", with_pictures(np.zeros(shape))
    yield "noise", "not see", with_pictures(rng.normal(100, 3, shape))
    yield "strong noise", "not see", with_pictures(rng.normal(120, 30, shape))
    moving = np.stack([np.roll(good.pictures[0], 2 * k, axis=1) for k in range(len(good.pictures))])
    yield "something moves before the camera", "not see", with_pictures(moving)
    wobble = 100 + 60 * np.sin(np.arange(shape[0]) / 3)[:, None, None] + rng.normal(0, 2, shape)
    yield "a lamp that flickers", "not see", with_pictures(wobble)
    other = recording(Loop(seed=99, duration_s=duration_s))
    yield (
        "another pattern",
        "not see",
        attrs.evolve(other, t_flip_ns=good.t_flip_ns, bright=good.bright),
    )
    faces = np.stack(
        [cv2.GaussianBlur(rng.normal(120, 90, shape[1:]), (0, 0), 3) for _ in range(shape[0])]
    )
    yield "a film", "not see", with_pictures(faces)
    yield "saturated", "not see", with_pictures(np.full(shape, 255.0))
    for exposure_ms in (60.0, 65.0):
        long = Loop(camera_hz=15.07, exposure_ms=exposure_ms, duration_s=duration_s)
        yield f"exposure of {exposure_ms:g} ms", "exposure", recording(long)
    for exposure_ms in (75.0, 95.0):
        long = Loop(camera_hz=10.03, exposure_ms=exposure_ms, duration_s=duration_s)
        yield f"exposure of {exposure_ms:g} ms at 10 Hz", "exposure", recording(long)
    yield "no stamps", "no stamps", attrs.evolve(good, stamped=False)
    for jitter_ms in (9.0, 14.0):
        times = good.t_frame_ns + (rng.normal(0, jitter_ms, shape[0]) * 1e6).astype(np.int64)
        yield f"stamps {jitter_ms:g} ms off", "irregular", attrs.evolve(good, t_frame_ns=times)
    stuck = good.t_frame_ns.copy()
    stuck[1::2] = stuck[::2][: len(stuck[1::2])]
    yield "every stamp twice", "irregular", attrs.evolve(good, t_frame_ns=stuck)
    yield (
        "camera stops after 1 s",
        "frames",
        attrs.evolve(good, t_frame_ns=good.t_frame_ns[:30], pictures=good.pictures[:30]),
    )
    yield (
        "a window that froze",
        "presented",
        attrs.evolve(good, t_flip_ns=good.t_flip_ns[:9], bright=good.bright[:9]),
    )
    exact = Loop(
        exposure_ms=1.0,
        response_ms=0.0,
        readout_ms=0.0,
        stamp_ms=0.0,
        roll_deg=0.0,
        duration_s=duration_s,
    )
    yield "in step, short exposure", "in step", recording(exact)
    yield (
        "screen at the top of the picture",
        "above",
        recording(Loop(off=-0.3, size=0.5, duration_s=duration_s)),
    )


def outcome(made: Recording) -> LoopDelay | str:
    """The delay, or why it is refused."""
    try:
        return estimate(made)
    except UserError as error:
        return error.message


def run(count: int) -> None:
    rows, began = [], time.monotonic()
    for seed in range(1000, 1000 + count):  # the constants of the fit were chosen on seeds 0 to 59
        loop = drawn(np.random.default_rng(seed), seed)
        rows.append((loop, outcome(recording(loop))))
    took_s = (time.monotonic() - began) / count
    found = [(loop, delay) for loop, delay in rows if isinstance(delay, LoopDelay)]
    print(
        "| camera | runs | refused | within 1 ms | 90 % interval holds | error, median | 95 % | interval, median |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name, low, high in (("15 Hz", 0, 20), ("30 Hz", 20, 40), ("60 Hz", 40, 80), ("all", 0, 80)):
        of = [row for row in rows if low <= row[0].camera_hz < high]
        seen = [(loop, delay) for loop, delay in found if low <= loop.camera_hz < high]
        errors = np.array([abs(delay.delay_ms - loop.delay_ms) for loop, delay in seen])
        holds = sum(delay.low_ms <= loop.delay_ms <= delay.high_ms for loop, delay in seen)
        halves = np.median([delay.half_ms for _, delay in seen])
        print(
            f"| {name} | {len(of)} | {len(of) - len(seen)} | {(errors <= 1).sum() / len(of):.1%} | {holds / len(of):.1%}"
            f" | {np.median(errors):.2f} ms | {np.quantile(errors, 0.95):.2f} ms | +- {halves:.2f} ms |"
        )
    print(
        f"\nSimulated and fitted in {took_s:.1f} s a run.\n\n| must be refused | answer |\n|---|---|"
    )
    for what, word, made in bad_recordings():
        answer = outcome(made)
        right = isinstance(answer, str) and word in answer
        print(
            f"| {what} | {answer if isinstance(answer, str) else f'{answer.delay_ms:.1f} ms'}{'' if right else ' (WRONG)'} |"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    run(parser.parse_args().runs)
