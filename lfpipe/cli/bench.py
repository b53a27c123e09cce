"""`lfpipe bench`: a report of error against run time."""

from pathlib import Path
from typing import Any

import click

from lfpipe.cli.options import with_config

ANSWERS = {  # what each subject answers
    "tracker": "Which face engine: error against the true eyes, and time per frame.",
    "filters": "Which filter: error at the moment of display, still jitter, time per update.",
    "photon": "How long after the head the picture moves, at the onset of a motion and under way.",
    "judder": "Whether pictures and video miss refreshes of a simulated screen.",
    "synthesis": "Which method for views between: error on views left out, jumps, time per picture.",
    "anaglyph": "Which colours: rivalry, ghosts and colour error through simulated glasses.",
    "pipeline": "Whole sessions against the paper's loop: error on screen, latency, CPU.",
    "stability": "Whether stiff and extreme cases break anything, and for how long.",
}


class AllByDefault(click.Group):
    """A group that runs its command `all` when given options only, and shows its help when given nothing."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and args[0].startswith("-") and args[0] not in ("-h", "--help"):
            args = ["all", *args]
        return super().parse_args(ctx, args)


@click.group(cls=AllByDefault, invoke_without_command=True)
@click.pass_context
def bench(context: click.Context) -> None:
    """Measure error against run time, on this machine, your scene and your sequence.

    Writes a report that opens in any browser. The default inputs are the demo's scene and viewer.
    Start with: lfpipe bench all --quick
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def _measure(names: tuple[str, ...], given: dict[str, Any]) -> None:
    """Measures the subjects and writes the report."""
    from lfpipe.bench.inputs import make_inputs
    from lfpipe.bench.page import write_report
    from lfpipe.bench.runner import measure
    from lfpipe.cli.progress import progress
    from lfpipe.config import load

    settings = load(given["config_file"], given["sets"])
    with progress() as bar:
        inputs = make_inputs((given["scene"],) if given["scene"] else (), given["sequence"], given["quick"], settings, bar)
        results = measure(names, inputs, given["out"], bar)
    path = write_report(results, given["out"])
    for found in results.values():
        for name, reason in found.failures.items():
            click.echo(f"failed: {found.name}: {name}: {reason}", err=True)
    click.echo(path)


def _command(name: str, names: tuple[str, ...], about: str) -> click.Command:
    @click.option("--scene", type=click.Path(path_type=Path), metavar="SCENE",
                  help="Light field. Default: the demo's.")  # fmt: skip
    @click.option(
        "--sequence",
        type=click.Path(path_type=Path),
        metavar="SEQUENCE",
        help="A recorded sequence, or a video; VIDEO.csv holds its true eyes. Default: the demo's.",
    )
    @click.option("--out", type=click.Path(path_type=Path), default=Path("lfpipe-bench"), show_default=True, metavar="DIR",
                  help="Folder for results; an interrupted run continues there.")  # fmt: skip
    @click.option("--quick", is_flag=True, help="Fewer turns, smaller inputs: all subjects in about a minute of CPU.")
    @with_config
    def run(**given: Any) -> None:
        _measure(names, given)

    return click.command(name, help=about, short_help=about)(run)


bench.add_command(_command("all", tuple(ANSWERS), "Measure every subject: which method, filter and engine to use here, and why."))
for _name, _answer in ANSWERS.items():
    bench.add_command(_command(_name, (_name,), _answer))


@bench.command()
@click.argument("scenes", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FOLDER...")
@click.option("--keep", type=click.Choice(["2", "3"]), default="2", show_default=True, help="Views kept per side.")
@click.option("--crop", type=click.Choice(["central", "top-left"]), default="central", show_default=True,
              help="Which 7x7 views of a larger grid: central (DistgASR) or top-left (LFASR-geo, ELFR).")  # fmt: skip
@click.option("--border", type=click.IntRange(0, 1000), default=22, show_default=True, metavar="PX", help="Crop per side.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("lfpipe-table"), show_default=True, metavar="DIR",
              help="Folder for results; an interrupted run continues there.")  # fmt: skip
@click.option("--untimed", is_flag=True, help="PSNR and SSIM only.")
@with_config
def table(
    scenes: tuple[Path, ...],
    keep: str,
    crop: str,
    border: int,
    out: Path,
    untimed: bool,
    config_file: str | None,
    sets: tuple[str, ...],
) -> int:
    """Measure every method by the protocol of angular super-resolution, 2x2 -> 7x7 views.

    FOLDER is a light field of any layout. The table shows PSNR, SSIM, and the time and memory per picture. It also quotes results
    published in papers; those were not run here. The exit code is 1 if a scene was left out.
    """
    from functools import partial

    import cv2

    from lfpipe.bench.conditions import source_digest
    from lfpipe.bench.table import Protocol, markdown, measure, write
    from lfpipe.cli.progress import progress
    from lfpipe.config import load
    from lfpipe.host.machine import versions
    from lfpipe.scene.open_scene import open_scene

    settings = load(config_file, sets)
    protocol = Protocol(int(keep), crop, border)
    identity = f"{source_digest()} {sorted(versions().items())}"
    cv2.setNumThreads(1)  # as in a session; the table's heading says one thread
    with progress() as bar:
        fields = [(path, partial(open_scene, path, settings.scene, bar)) for path in scenes]
        lines = measure(fields, protocol, identity, out, bar, not untimed)
    page = write(lines, protocol, out)
    click.echo(markdown(lines, protocol))
    click.echo(page)
    return 1 if any(line.left_out for line in lines) else 0
