"""Subject: pictures shown twice or left out, on a simulated screen, by the session's own clock, lead and choice of video frames.

The compositor takes what was handed over DEADLINE_MS before a blank. Composing takes COST_MS (log-normal), wake-ups are late by
0.1 ms (exponential), a share of them by 5 ms more; blanks are reported to whole ms. All from a fixed seed.
"""

import math
from collections.abc import Iterator

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import State, judged_table
from lfpipe.bench.runner import Offer
from lfpipe.render.refresh import ScreenRefresh
from lfpipe.render.viewer import VIDEO_LEAD, video_frame
from lfpipe.transport.clock import MS_NS

SCREENS_HZ = (
    59.94,
    60.0,
    75.0,
    143.98,
    144.0,
)  # as monitors of 60, 75 and 144 Hz report themselves
VIDEOS_HZ = (24.0, 25.0, 30.0)  # of films, European and American television
DEADLINE_MS, COST_MS, SLOW_SHARES = (
    3.0,
    1.5,
    (0.0, 0.02),
)  # of usual compositors; of warp2 at 512x512; of a busy machine
PICTURES = 4000  # a minute at 60 Hz: the second half stands for a session that has settled
GOAL, LIMIT = (
    0.005,
    0.02,
)  # one picture in 200 is hardly seen; a busy machine's late wake-ups alone make 2 %
T0_NS = 10**12  # any moment


@attrs.frozen
class ScreenRun:
    """Pictures of the second half of a run. juddered: share that missed their blanks. lead_ms: from beginning to blank, mean.
    blanks: int64 (n,), those that showed a picture, counted from T0_NS. targets_ns: int64 (n,), what they were made for."""

    juddered: float
    lead_ms: float
    blanks: NDArray[np.int64]
    targets_ns: NDArray[np.int64]


def simulate(
    rate_hz: float,
    deadline_ms: float,
    pictures: int,
    cost_ms: float = 1.0,
    slow: float = 0.0,
    whole_ms: bool = False,
) -> ScreenRun:
    """A screen of rate_hz. slow: share of wake-ups that are 5 ms late in the mean. whole_ms: blanks are reported in whole ms."""
    random = np.random.default_rng(5)
    refresh = ScreenRefresh(rate_hz, T0_NS)
    clock = refresh.clock
    period_ns, bad, leads, blanks, targets = 1e9 / rate_hz, [], [], [], []
    clock.blank(T0_NS)
    now_ns, missed = T0_NS, 0
    for _ in range(pictures):
        due_ns, begin_ns = refresh.due_ns(), max(now_ns, refresh.due_ns() - refresh.lead_ns())
        woken_ns = (
            begin_ns
            + random.exponential(0.1) * MS_NS
            + (random.random() < slow) * random.exponential(5) * MS_NS
        )
        now_ns = round(woken_ns + cost_ms * random.lognormal(0, 0.2) * MS_NS)
        refresh.took(now_ns - round(woken_ns), round(woken_ns), due_ns)
        now_ns = max(now_ns, refresh.earliest_ns(due_ns))
        blank = math.ceil((now_ns + deadline_ms * MS_NS - T0_NS) / period_ns)
        shown_ns = round(T0_NS + blank * period_ns)
        if whole_ms:
            shown_ns = shown_ns // MS_NS * MS_NS + MS_NS // 2
        leads.append(refresh.lead_ns() / MS_NS)
        bad.append(refresh.judge(due_ns, now_ns, shown_ns))
        blanks.append(blank)
        targets.append(due_ns)
        clock.blank(shown_ns)
        missed += refresh.advance(now_ns)
    half = pictures // 2
    juddered = float(np.mean(bad[half:])) + missed / pictures
    return ScreenRun(
        juddered, float(np.mean(leads[half:])), np.array(blanks[half:]), np.array(targets[half:])
    )


def video_judder(run: ScreenRun, rate_hz: float, video_hz: float) -> tuple[float, str]:
    """Share of blanks at which a video showed another frame than planned, and for how many blanks it held its frames.

    Planned is what a screen without lateness shows: at each blank the frame whose time it is.
    """
    lead_ns = round(VIDEO_LEAD * 1e9 / rate_hz)
    start_ns = int(run.targets_ns[0]) - lead_ns
    frames = np.array([video_frame(int(t_ns), start_ns, video_hz) for t_ns in run.targets_ns])
    every = np.arange(run.blanks[0], run.blanks[-1])
    seen = frames[np.searchsorted(run.blanks, every, side="right") - 1]
    period_ns = 1e9 / rate_hz
    planned = np.array(
        [
            video_frame(round(start_ns + lead_ns + k * period_ns), start_ns, video_hz)
            for k in every - every[0]
        ]
    )
    held = np.diff(np.flatnonzero(np.diff(planned)))
    return float(np.mean(seen != planned)), " or ".join(map(str, np.unique(held)))


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Moving eyes and video at each rate, on a quiet and on a busy machine."""
    note = (
        "Share of pictures that missed their blank, and of blanks that showed another frame of a video than planned; for how"
        f" many blanks each frame is held by plan. ok: at most {GOAL:.1%}."
    )
    videos_hz = {"moving eyes": 0.0, **{f"video of {hz:g} Hz": hz for hz in VIDEOS_HZ}}
    for slow in SLOW_SHARES:
        screens = {
            f"{hz:g} Hz": (hz, simulate(hz, DEADLINE_MS, PICTURES, COST_MS, slow, whole_ms=True))
            for hz in SCREENS_HZ
        }
        title = f"Judder, {f'{slow:.0%} of wake-ups late by 5 ms' if slow else 'quiet machine'}"
        yield judged_table(title, note, "screen", screens, videos_hz, _judged)


def _judged(screen: tuple[float, ScreenRun], video_hz: float) -> tuple[str, State]:
    rate_hz, run = screen
    share, held = video_judder(run, rate_hz, video_hz) if video_hz else (run.juddered, "")
    state: State = "ok" if share <= GOAL else "degraded" if share <= LIMIT else "failed"
    return f"{share:.2%}" + (f", held {held}" if held else ""), state
