"""`lfpipe bench`: a report of error against run time."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click

from lfpipe.bench.benchmarks import BENCHMARKS, TABLE
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.page import write_report
from lfpipe.bench.results import Results, write
from lfpipe.bench.runner import measure, opened
from lfpipe.bench.simulator.metrics import beyond
from lfpipe.bench.summary import headlines, sentence
from lfpipe.bench.table import Protocol, measure_scenes
from lfpipe.cli.terminal import PATH, Group, print_result, progress, say, with_config
from lfpipe.config import Config
from lfpipe.scene.pack import open_scene
from lfpipe.supervisor.process_table import SCORER

OUT = click.option(
    "--out",
    type=PATH,
    default=Path("lfpipe-bench"),
    show_default=True,
    metavar="DIR",
    help="Folder for results; those of other benchmarks are kept.",
)


@click.group(cls=Group)
def bench() -> None:
    """Measure error against run time on this machine, with your scene and sequence.

    The report opens in any browser. Start with: lfpipe bench all --quick
    """


def _command(name: str, benchmarks: tuple[str, ...], about: str) -> click.Command:
    @click.option("--scene", type=PATH, metavar="SCENE", help="Light field; default: the demo.")
    @click.option(
        "--sequence",
        type=PATH,
        metavar="SEQUENCE",
        help="Recorded sequence, or a video with its true eyes in VIDEO.csv; default: the demo.",
    )
    @OUT
    @click.option(
        "--quick",
        is_flag=True,
        help="Fewer repetitions and smaller inputs.",
    )
    @with_config
    def run(
        scene: Path | None, sequence: Path | None, out: Path, quick: bool, config: Config
    ) -> None:
        with progress() as bar:
            inputs = Inputs(
                scene_path=scene, sequence_path=sequence, quick=quick, settings=config, progress=bar
            )
            results = measure(benchmarks, inputs, out, bar)
        _report(results, out, benchmarks)

    return click.command(name, help=about, short_help=about)(run)


bench.add_command(
    _command(
        "all",
        tuple(BENCHMARKS),
        "Run every benchmark: which method, filter and engine to use here, and why.",
    )
)
for _name, _benchmark in BENCHMARKS.items():
    if _name != "viewer":
        bench.add_command(
            _command(
                _name, (_name,), _benchmark.question.partition("? ")[0].removesuffix("?") + "?"
            )
        )


@bench.command(short_help="What does each eye see, against what it should see?")
@click.option(
    "--track",
    "tracks",
    type=PATH,
    multiple=True,
    metavar="CSV",
    help="Add a recorded head track: t_s, face, left_x, left_y, right_x, right_y.",
)
@OUT
@click.option("--quick", is_flag=True, help="Fewer pictures.")
@click.option("--check", is_flag=True, help="Exit with 1 if a metric exceeds its bound.")
def viewer(tracks: tuple[Path, ...], out: Path, quick: bool, check: bool) -> int:
    """Measure what each eye sees against what it should see, in a simulator with ground truth.

    Scripted viewers sit, sway, leave and return in front of a simulated camera and screen. Scenes
    are drawn exactly from any viewpoint. Time is simulated: every run yields the same errors.
    """
    with progress() as bar:
        results = measure(("viewer",), Inputs(quick=quick, tracks=tracks), out, bar)
    _report(results, out, ("viewer",))
    lines = beyond(results["viewer"])
    if check:
        for line in lines:
            say(line)
    return 1 if check and (lines or results["viewer"].failures) else 0


@bench.command(short_help="Measure every method on held-out views, by the published protocol.")
@click.argument("scenes", nargs=-1, required=True, type=PATH, metavar="FOLDER...")
@click.option(
    "--keep",
    type=click.Choice(["2", "3"]),
    default="2",
    show_default=True,
    help="Views kept per side.",
)
@click.option(
    "--border",
    type=click.IntRange(0, 1000),
    default=22,
    show_default=True,
    metavar="PX",
    help="Crop per side.",
)
@click.option(
    "--out",
    type=PATH,
    default=Path("lfpipe-table"),
    show_default=True,
    metavar="DIR",
    help="Folder for results.",
)
@click.option("--untimed", is_flag=True, help="PSNR and SSIM only.")
@with_config
def table(
    scenes: tuple[Path, ...], keep: str, border: int, out: Path, untimed: bool, config: Config
) -> int:
    """Measure every method by the protocol of angular super-resolution, 2x2 -> 7x7 views.

    FOLDER is a light field of any layout. The table shows PSNR, SSIM, and the time per picture. The
    exit code is 1 if a scene was skipped.
    """
    opened(out)
    with progress() as bar:
        fields = [
            (path, partial(open_scene, path, config.scene, bar, scorer=SCORER)) for path in scenes
        ]
        results = measure_scenes(fields, Protocol(int(keep), border, not untimed), bar)
    write({TABLE.name: results}, out)
    if results.rows:
        print_result(results.tables[0].markdown())
    for reason in results.left_out:
        print_result(f"skipped: {reason}")
    _report({TABLE.name: results}, out)
    return 1 if results.left_out or results.failures else 0


def _report(results: dict[str, Results], out: Path, names: Sequence[str] = ()) -> None:
    """Writes the report of all results; prints its path, and what the named ones found."""
    for one in results.values():
        for method, reason in one.failures.items():
            say(f"failed: {method}: {reason}")
    print_result(write_report(results, out))
    for name in names:
        if text := sentence(BENCHMARKS[name], results[name]):
            print_result(f"{BENCHMARKS[name].title}: {text}")
        for text, own, paper in headlines(results[name]):
            print_result(f"{text}: {own}; the paper's pipeline {paper}")
