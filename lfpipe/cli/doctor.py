"""`lfpipe doctor`: checks whether a session would run on this machine."""

from pathlib import Path

import click


@click.command()
@click.option("--report", type=click.Path(path_type=Path), metavar="FILE",
              help="Also pack versions, settings, and the log and state of sessions into a ZIP, for a bug report.")  # fmt: skip
def doctor(report: Path | None) -> int:
    """Check this machine: one line per check, with remedies. Exit code 1 if `lfpipe up SCENE` would fail."""
    from lfpipe.cli.progress import filled
    from lfpipe.observe.doctor import checks

    found = checks()
    if report is not None:
        from lfpipe.observe.report import write_report

        write_report(report, found)
    for check in found:
        head = f"{'ok  ' if check.ok else 'FAIL'} {check.name:<12} "
        click.echo(filled(check.detail, head))
        if check.remedy:
            click.echo(filled(f"remedy: {check.remedy}", " " * len(head)))
    return 0 if all(check.ok for check in found) else 1
