"""Trials of `lfpipe bench compare` with builds whose difference is known: an equal build, one whose compositor is 10 % slower,
one with 0.2 px more noise in its tracker. Prints a Markdown table; exit code 1 if a trial reports a false difference or
misses one.

    uv run python profiling/compare_tries.py [--tries 20] > profiling/results/compare.md

60 trials take 9 minutes on two idle cores (light field of 9x9 views of 128x128 px, 75 frames of 640x480). Every trial is a
whole comparison with its own processes.
"""

import os
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

import attrs
from arguments import parser_of, start

from lfpipe.bench.builds import CURVES, compare_builds
from lfpipe.bench.comparison import Difference
from lfpipe.bench.inputs import demo_sequence
from lfpipe.scene.demo import demo_scene

HERE = Path(__file__).resolve().parents[1]
VIEW_PX, MOVING_S, BUDGET_S = 128, 0.5, 12.0
Patch = tuple[str, str, str]  # a file, the head of a method in it, and its replacement in the other build
SLOWER: Patch = (
    "lfpipe/render/compositor.py",
    "    def compose(self, left: Position, right: Position, frame: int = 0) -> NDArray[np.uint8]:\n",
    """    def compose(self, left: Position, right: Position, frame: int = 0) -> NDArray[np.uint8]:
        import time

        start = time.perf_counter_ns()
        picture = self._composed(left, right, frame)
        end = time.perf_counter_ns() + (time.perf_counter_ns() - start) // 10
        while time.perf_counter_ns() < end:
            pass
        return picture

    def _composed(self, left: Position, right: Position, frame: int = 0) -> NDArray[np.uint8]:
""",
)
NOISIER: Patch = (
    "lfpipe/track/litert_engine.py",
    "    def detect(self, image: NDArray[np.uint8]) -> Face | None:\n",
    """    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        face = self._detected(image)
        if "_rng" not in self.__dict__:
            self._rng = np.random.default_rng()
        if face is not None:
            face.eyes_px[:] += self._rng.normal(0.0, 0.2, face.eyes_px.shape)
        return face

    def _detected(self, image: NDArray[np.uint8]) -> Face | None:
""",
)


@attrs.frozen
class Case:
    """A patched build. wanted: (subject, part of the figures' names) that must all be called worse."""

    title: str
    patch: Patch | None
    wanted: tuple[str, str]

    def missed(self, found: list[Difference]) -> list[Difference]:
        return [d for d in found if self.concerns(d) and not d.worse]

    def concerns(self, one: Difference) -> bool:
        subject, text = self.wanted
        return self.patch is not None and one.subject == subject and text in one.figure


CASES = (
    Case("the same code", None, ("", "")),
    Case("compositor 10 % slower", SLOWER, ("synthesis", "time per picture")),
    Case("0.2 px of noise on the eyes", NOISIER, ("tracker", "error of the worse eye")),
)


def copied(folder: Path, patch: Patch | None) -> Path:
    """A patched copy of this checkout's package."""
    shutil.copytree(HERE / "lfpipe", folder / "lfpipe", ignore=shutil.ignore_patterns("__pycache__"))
    if patch is not None:
        path, before, after = folder / patch[0], patch[1], patch[2]
        text = path.read_text()
        assert text.count(before) == 1, f"{patch[0]}: {before!r} is not there exactly once"
        path.write_text(text.replace(before, after))
    return folder


def span(values: list[float]) -> str:
    return f"{min(values):.2f} to {max(values):.2f}" if values else ""


def main() -> int:
    tries = parser_of(__doc__, tries=20).parse_args().tries
    started, loads, wrong, rows = time.monotonic(), list[float](), list[str](), list[str]()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        one, *others = (copied(root / f"build{k}", patch) for k, patch in enumerate((None, *(case.patch for case in CASES))))
        inputs = demo_scene(root, lambda *_: None, size_px=VIEW_PX), demo_sequence(root, MOVING_S)
        for case, other in zip(CASES, others, strict=True):
            seconds, ratios = list[float](), dict[str, list[float]]()
            all_called, stray, unsettled, compared = 0, 0, list[int](), 0
            for k in range(tries):
                print(f"\r{case.title}: {k} of {tries}  ", end="", file=sys.stderr, flush=True)
                pair, begun = (one, other) if k % 2 == 0 else (other, one), time.monotonic()
                found = compare_builds(*pair, tuple(CURVES), lambda *_: None, inputs, root / "cache", BUDGET_S)
                if k % 2:
                    found = [exchanged(d) for d in found]
                seconds.append(time.monotonic() - begun)
                loads.append(os.getloadavg()[0])
                compared = len(found)
                missed, strays = case.missed(found), [d for d in found if d.called and not case.concerns(d)]
                all_called += not missed
                stray += len(strays)
                unsettled.append(sum(not d.settled for d in found))
                wrong_here = [f"{case.title}, try {k + 1}: {d}" for d in (*missed, *strays)]
                wrong += wrong_here
                print("".join(f"\r{text}\n" for text in wrong_here), end="", file=sys.stderr)
                for d in found:
                    if case.concerns(d) and "p95" not in d.figure:
                        ratios.setdefault(d.figure, []).append(d.ratio)
            must = f"{all_called} of {tries}" if case.patch else ""
            ratios_text = "; ".join(f"{name}: {span(values)}" for name, values in ratios.items())
            unsure, wrongly = f"{statistics.mean(unsettled):.1f} of {compared}", f"{stray} of {compared * tries}"
            cells = case.title, tries, must, wrongly, unsure, ratios_text, f"{statistics.median(seconds):.1f} s"
            rows.append(f"| {' | '.join(map(str, cells))} |")
    minutes = (time.monotonic() - started) / 60
    print(f"\n{minutes:.1f} minutes", file=sys.stderr)
    print("# `lfpipe bench compare` on builds whose difference is known\n")
    print("    uv run python profiling/compare_tries.py > profiling/results/compare.md\n")
    print(f"{minutes:.1f} minutes on {len(os.sched_getaffinity(0))} cores, load {span(loads)} (1 is its own).\n")
    print("| B compared with A | trials | all differences called | false calls | unsure at the end | ratios | time of a trial |")
    print("|---|---:|---:|---:|---:|---|---:|")
    print("\n".join(rows))
    if wrong:
        print("\nWrong:\n\n" + "\n".join(f"- {text}" for text in wrong))
    return 1 if wrong else 0


def exchanged(one: Difference) -> Difference:
    """The difference with A and B exchanged."""
    low, high = 1 / one.high, 1 / one.low
    return attrs.evolve(one, ratio=1 / one.ratio, low=low, high=high, worse=one.called and not one.worse)


if __name__ == "__main__":
    start(main)
