"""`lfpipe sweep`: runs many measurements over a corpus, on this machine or on a cluster."""

from pathlib import Path

import click

from lfpipe.cli.terminal import OVERWRITE, PATH, Number, print_result, progress, say
from lfpipe.errors import UserError
from lfpipe.host import signals


@click.command()
@click.argument("plan", type=PATH, metavar="PLAN.toml")
@click.option(
    "--out",
    type=PATH,
    default=Path("lfpipe-sweep"),
    show_default=True,
    metavar="DIR",
    help="Folder for results.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 1024),
    metavar="N",
    help="Workers on this machine. Default: one per core.",
)
@click.option(
    "--on",
    "address",
    default="",
    metavar="tls://SCHEDULER",
    help="Use the workers of a Dask scheduler.",
)
@click.option(
    "--insecure",
    is_flag=True,
    help="With --on: accept a scheduler without TLS. Anyone who can reach it can run code.",
)
@click.option(
    "--limit",
    type=Number(1),
    default=3600.0,
    show_default=True,
    metavar="S",
    help="Maximum seconds for one cell.",
)
@click.option(
    "--expect",
    type=PATH,
    metavar="DIR",
    help="Compare with the references in this folder.",
)
@click.option("--update", is_flag=True, help="Write the references of --expect instead.")
@click.option(
    "--junit",
    type=PATH,
    metavar="FILE",
    help="Write the outcome as JUnit XML.  [default: junit.xml in DIR]",
)
@OVERWRITE
def sweep(
    plan: Path,
    out: Path,
    jobs: int | None,
    address: str,
    insecure: bool,
    limit: float,
    expect: Path | None,
    update: bool,
    junit: Path | None,
    overwrite: bool,
) -> int:
    """Run replays, quality measurements and benchmarks over the recordings and scenes of PLAN.toml.

    \b
    sequences = ["recordings/*"]
    scenes = ["scenes/*"]
    subjects = ["replay", "truth", "quality", "table", "synthesis"]
    [config]
    "render.method" = ["warp", "warp2"]
    [table]
    keep = [2, 3]

    Each combination is a cell. To continue an interrupted sweep, run the same command: finished
    cells are skipped.
    Exit code 0: equal, 1: a cell failed or differs, 2: invalid input.
    """
    from lfpipe.extras.sweep.plan import read_plan
    from lfpipe.extras.sweep.results import DIFFERS, FAILED, verdict, write
    from lfpipe.extras.sweep.run import dask_workers, local_workers, run_sweep
    from lfpipe.extras.sweep.work import SweepOptions, check_references
    from lfpipe.files.safe_files import check_output, check_outside
    from lfpipe.host.worker import usable_cores

    if update and expect is None:
        raise UserError("--update needs references", "name their folder with --expect DIR")
    if jobs and address:
        raise UserError(
            "--jobs and --on exclude each other",
            "leave --jobs out: the scheduler has its own workers",
        )
    cells = read_plan(plan)
    inputs = {Path(place) for cell in cells for place in (cell.sequence, cell.scene) if place}
    options = SweepOptions(limit, str(expect.resolve()) if expect else "", update)
    check_outside(out, [*inputs, expect], "--out")
    if junit is not None:
        check_output(junit, [plan, *inputs, *filter(None, [expect])], overwrite, "--junit")
    if expect is not None:
        check_outside(expect, inputs if update else (), "--expect")
        check_references(options, cells)
    workers = (
        dask_workers(address, insecure) if address else local_workers(jobs or len(usable_cores()))
    )
    try:
        with progress() as bar:
            outcomes = run_sweep(cells, out, workers, options, bar, say)
    except KeyboardInterrupt as error:
        say(f"interrupted; finished cells are in {out}; the same command continues")
        return signals.exit_code(error)
    page = write(outcomes, out, junit)
    wrong = [outcome for outcome in outcomes if outcome.state in (FAILED, DIFFERS)]
    for outcome in wrong:
        print_result(f"{outcome.state}: {outcome.cell.name}: {outcome.reason}")
    print_result(verdict(outcomes))
    print_result(page)
    return 1 if wrong else 0
