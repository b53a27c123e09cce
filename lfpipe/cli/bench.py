"""`lfpipe bench`: error against run time, as a report; and what differs between two builds or two runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from lfpipe.cli.options import with_config

NAMES = ("tracker", "filters", "synthesis", "anaglyph", "storage", "pipeline", "stability", "plan")


class AllByDefault(click.Group):
    """A group whose options alone mean its command `all`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args or (args[0].startswith("-") and args[0] not in ("-h", "--help")):
            args = ["all", *args]
        return super().parse_args(ctx, args)


@click.group(cls=AllByDefault)
def bench() -> None:
    """Measure error against run time, on this machine, your scene and your sequence.

    Writes a report that opens in any browser. Without input the demo's scene and viewer are measured.
    """


def _measured(names: tuple[str, ...], given: dict[str, Any]) -> None:
    """Measures the subjects and writes the report."""
    from lfpipe.bench.inputs import make_inputs
    from lfpipe.bench.measure import measure
    from lfpipe.bench.report import write_report
    from lfpipe.cli.progress import progress
    from lfpipe.config import load

    settings = load(given["config_file"], given["sets"])
    with progress() as bar:
        inputs = make_inputs(given["scene"], given["sequence"], given["quick"], settings, bar)
        results = measure(names, inputs, given["out"], bar)
    path = write_report(results, given["out"])
    for found in results.subjects.values():
        for name, reason in found.omissions.items():
            click.echo(f"omitted {found.name}: {name}: {reason}", err=True)
    click.echo(path)


def _command(name: str, names: tuple[str, ...], about: str) -> click.Command:
    @click.option("--scene", multiple=True, type=click.Path(path_type=Path), metavar="SCENE",
                  help="Light field; repeated, `plan` looks at each. Without it the demo's.")  # fmt: skip
    @click.option("--sequence", type=click.Path(path_type=Path), metavar="VIDEO", help="Frames; VIDEO with .csv holds the truth.")
    @click.option("--out", type=click.Path(path_type=Path), default=Path("lfpipe-bench"), show_default=True, metavar="DIR",
                  help="Where results go; a run broken off goes on from there.")  # fmt: skip
    @click.option("--quick", is_flag=True, help="A minute and a half for all: fewer turns, smaller inputs.")
    @with_config
    def run(**given: Any) -> None:
        _measured(names, given)

    return click.command(name, help=about, short_help=about)(run)


bench.add_command(_command("all", NAMES, "Measure every subject."))
for _name in NAMES:
    bench.add_command(_command(_name, (_name,), f"Measure the subject {_name}."))


@bench.command()
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@click.option("--subject", "subjects", multiple=True, type=click.Choice(["tracker", "filters", "synthesis", "anaglyph"]),
              help="Of two builds: measure this one only; repeatable.")  # fmt: skip
@click.option(
    "--on", nargs=2, type=click.Path(path_type=Path), metavar="SCENE VIDEO", help="Of two builds: not the demo's inputs."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def compare(a: Path, b: Path, subjects: tuple[str, ...], on: tuple[Path, Path] | None, as_json: bool) -> int:
    """Tell what B does better or worse than A, beyond noise.

    A and B are two source checkouts of lfpipe, run in turns here and now until all is clear or a minute is over, or two folders
    that --out wrote: of those only times are told that differ by more than a tenth. Ends with 1 where B is worse in anything.
    """
    import json

    import attrs

    from lfpipe.bench.builds import compare_builds, is_build
    from lfpipe.bench.compare import compare_results
    from lfpipe.bench.results import read
    from lfpipe.cli.progress import progress

    if is_build(a) and is_build(b):
        with progress() as bar:
            found = compare_builds(a, b, subjects or ("tracker", "synthesis"), bar, on or ())
    else:
        found = compare_results(read(a), read(b))
    called, unsure = [one for one in found if one.called], sum(not one.settled for one in found)
    if as_json:
        told = {"compared": len(found), "called": [attrs.asdict(one) for one in called], "unsure": unsure}
        click.echo(json.dumps(told))
    else:
        for one in called:
            click.echo(str(one))
        click.echo(f"{len(found)} figures compared, {len(called)} differ beyond noise, {unsure} too noisy to tell")
    return 1 if any(one.worse for one in called) else 0
