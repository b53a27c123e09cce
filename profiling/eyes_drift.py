"""Do the eye filters drift? Millions of updates of the code that tracks.

    uv run python profiling/eyes_drift.py [--updates 1000000] [--channels 1000] [--steps 100000]

In sequence, every filter: eyes on a path that repeats every 600 frames, with noise that repeats too. A settled output must
repeat as well; the drift is the difference between the last round and the third, in px.

In batch, the filters whose weights do not depend on the measurements (mean, kalman; their arithmetic accepts any shape):
--channels pairs of eyes with --steps updates each, compared with the same recurrence in long double. Prints the largest
difference in px at powers of ten.
"""

import time

import numpy as np
from arguments import parser_of, start
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.track.filters import make_filter
from lfpipe.track.kalman import Covariance, Kalman
from lfpipe.track.smoothing import Mean

ROUND, DT_NS = 600, 33_333_333
NAMES = ("predictive", "one-euro", "kalman", "mean")
AGILITY, MEAN_K = 1e4, 5


def path() -> NDArray[np.float64]:
    """(ROUND, 2, 2) px: two eyes that move, rest and move back, with 0.3 px of noise."""
    turn = np.clip(np.sin(np.arange(ROUND) * 2 * np.pi / ROUND) * 2, -1, 1)
    eyes = np.array([[351.3, 240.7], [288.1, 241.9]]) + turn[:, None, None] * np.array([90.0, 20.0])
    return np.asarray(eyes + np.random.default_rng(1).normal(0, 0.3, eyes.shape))


def in_sequence(name: str, updates: int) -> tuple[float, float]:
    """(drift in px, us per update) of one filter."""
    measured, smooth = path(), make_filter(Track(filter=name))  # type: ignore[arg-type]
    third, drift, began = np.empty_like(measured), 0.0, time.perf_counter()
    for k in range(updates):
        position, velocity = smooth.update(k * DT_NS, measured[k % ROUND])
        ahead = position + velocity * 0.03
        if 2 * ROUND <= k < 3 * ROUND:
            third[k % ROUND] = ahead
        elif k >= updates - ROUND:
            drift = max(drift, float(np.abs(ahead - third[k % ROUND]).max()))
    return drift, (time.perf_counter() - began) / updates * 1e6


def in_batch(name: str, channels: int, steps: int) -> list[tuple[int, float]]:
    """[(updates of a channel, largest difference from long double so far in px)], at powers of ten and at the end."""
    rng, long = np.random.default_rng(2), np.longdouble
    kalman = name == "kalman"
    smooth = Kalman(AGILITY) if kalman else Mean(MEAN_K)
    noise = rng.normal(0, 0.3, (97, channels, 2, 2))  # 97 and the round of the path are coprime
    base, dt = path(), long(DT_NS / 1e9)
    covariance = Covariance(long(1), long(0), long(Kalman.START_SPREAD), long(Kalman.START_SPREAD))  # type: ignore[arg-type]
    position = velocity = np.zeros((channels, 2, 2), long)
    ring: list[NDArray[np.longdouble]] = []
    differences, worst = [], 0.0
    for k in range(steps):
        measured = base[k % ROUND] + noise[k % 97]
        got, got_velocity = smooth.update(k * DT_NS, measured)
        if not kalman:
            ring = [*ring[-MEAN_K + 1 :], measured.astype(long)]
            position = np.sum(ring, axis=0) / len(ring)
        elif k == 0:
            position = measured.astype(long)
        else:
            covariance, gain, gain_velocity = covariance.ahead(dt, long(AGILITY)).measured(long(1))  # type: ignore[arg-type]
            ahead = position + velocity * dt
            position, velocity = ahead + gain * (measured - ahead), velocity + gain_velocity * (measured - ahead)
        if k < 100 or k % 101 == 0 or k == steps - 1:
            apart = np.abs((got + got_velocity * 0.03) - (position + velocity * long(0.03)))
            worst = max(worst, float(apart.max()))
        if k + 1 in (10, 100, 1000, 10_000, 100_000, 1_000_000) or k == steps - 1:
            differences.append((k + 1, worst))
    return list(dict(differences).items())


def main() -> None:
    args = parser_of(__doc__, updates=1_000_000, channels=1000, steps=100_000).parse_args()
    print("in sequence          updates   drift px   us/update", flush=True)
    for name in NAMES if args.updates else ():
        drift, us = in_sequence(name, args.updates)
        print(f"{name:12} {args.updates:15,d} {drift:10.1e} {us:11.1f}", flush=True)
    print("in batch: largest difference from long double, px, by the number of updates of each channel", flush=True)
    for name in ("kalman", "mean") if args.steps else ():
        cells = "   ".join(f"{count:,d}: {worst:.1e}" for count, worst in in_batch(name, args.channels, args.steps))
        print(f"{name:12} {args.channels * args.steps:15,d} updates   {cells}", flush=True)


if __name__ == "__main__":
    start(main)
