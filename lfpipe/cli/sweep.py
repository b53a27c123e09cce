"""`lfpipe sweep`: runs many measurements over a corpus, on this machine or on a cluster."""

from functools import partial
from pathlib import Path

import click

from lfpipe.errors import UserError

PATH = click.Path(path_type=Path)


class RunByDefault(click.Group):
    """A group whose command `run` needs no name."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


@click.group(cls=RunByDefault, options_metavar="", subcommand_metavar="PLAN.toml | show DIR")
def sweep() -> None:
    """Run replays, quality and benchmarks over all recordings and scenes of PLAN.toml.

    \b
    sequences = ["recordings/*"]
    scenes = ["scenes/*"]
    subjects = ["replay", "truth", "quality", "table", "synthesis"]
    [config]
    "render.method" = ["warp", "warp2"]
    [table]
    keep = [2, 3]

    Each combination is a cell. Finished cells are not run again; an interrupted sweep continues with the same command.
    `lfpipe sweep run --help` lists the options.
    """


@sweep.command()
@click.argument("plan", type=PATH, metavar="PLAN.toml")
@click.option("--out", type=PATH, default=Path("lfpipe-sweep"), show_default=True, metavar="DIR", help="Folder for results.")
@click.option("--jobs", type=click.IntRange(1, 1024), metavar="N", help="Workers on this machine. Default: one per core.")
@click.option("--on", "address", default="", metavar="tls://SCHEDULER", help="Use the workers of a Dask scheduler instead.")
@click.option("--insecure", is_flag=True, help="With --on: accept a scheduler without TLS. Whoever reaches it can run code.")
@click.option("--limit", type=click.FloatRange(1), default=3600.0, show_default=True, metavar="S", help="Seconds for one cell.")
@click.option("--expect", type=PATH, metavar="DIR", help="Compare replays and quality with the references in this folder.")
@click.option("--update", is_flag=True, help="Write the references of --expect instead.")
@click.option("--junit", type=PATH, metavar="FILE", help="Write the outcome as JUnit XML.  [default: junit.xml in DIR]")
def run(
    plan: Path, out: Path, jobs: int | None, address: str, insecure: bool, limit: float, expect: Path | None, update: bool,
    junit: Path | None,
) -> int:  # fmt: skip
    """Run a plan; exit code 0: all as expected, 1: a cell failed or differs, 2: bad input."""
    try:
        import cryptography  # noqa: F401  the certificates of a local cluster

        from lfpipe.sweep.run import Options, sweep
    except ImportError as error:
        raise UserError(f"sweeps need the package {error.name}", "pip install 'lfpipe[sweep]'") from None
    from lfpipe.cli.progress import progress
    from lfpipe.files.output import check_output
    from lfpipe.host.processes import usable_cores
    from lfpipe.sweep.plan import read_plan
    from lfpipe.sweep.results import DIFFERS, FAILED, References, verdict, write

    if junit is not None:
        check_output(junit, [plan], label="--junit")
    if update and expect is None:
        raise UserError("--update needs references", "name their folder with --expect DIR")
    if jobs and address:
        raise UserError("--jobs and --on exclude each other", "leave --jobs out: the scheduler has its own workers")
    references = None if expect is None else References(expect, update)
    try:
        with progress() as bar:
            notice = partial(click.echo, err=True)
            options = Options(address, jobs or len(usable_cores()), limit, references, insecure, bar, notice)
            outcomes = sweep(read_plan(plan), out, options)
    except KeyboardInterrupt:
        click.echo(f"interrupted; finished cells are in {out}; the same command continues", err=True)
        return 130
    page = write(outcomes, out, junit)
    wrong = [outcome for outcome in outcomes if outcome.state in (FAILED, DIFFERS)]
    for outcome in wrong:
        click.echo(f"{outcome.state}: {outcome.cell.name}: {outcome.reason}")
    click.echo(verdict(outcomes))
    click.echo(page)
    return 1 if wrong else 0


@sweep.command()
@click.argument("folder", type=PATH, metavar="DIR")
def show(folder: Path) -> None:
    """Print the table of a sweep, finished or not."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from lfpipe.sweep.results import ABOUT, Store, by_subject, verdict

    outcomes = list(Store(folder, read_only=True).outcomes.values())
    console = Console()
    if not console.is_terminal:
        console.width = 240
    for subject, (head, *body) in by_subject(outcomes).items():
        known = [k for k, name in enumerate(ABOUT) if name != "subject" and any(row[k] for row in body)]
        table = Table(*(head[k] for k in known), "figures", title=subject, title_justify="left")
        for row in body:
            figures = (f"{name} {value}" for name, value in zip(head[len(ABOUT) :], row[len(ABOUT) :], strict=True) if value)
            table.add_row(*(Text(row[k]) for k in known), ", ".join(figures))
        console.print(table)
    console.print(verdict(outcomes))
