"""`lfpipe replay`: runs a recorded sequence through the real stages and compares the results with a reference."""

import contextlib
import difflib
import itertools
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from lfpipe.capture.spec import parse_source
from lfpipe.cli.options import with_config
from lfpipe.cli.scene import opened
from lfpipe.errors import UserError
from lfpipe.replays import run
from lfpipe.replays.compare import Comparison, cases_of, check_reference, compare
from lfpipe.replays.report import STEADY, about_scene, about_sequence, read_report, write_junit
from lfpipe.sequence.folder import open_sequence

PATH = click.Path(path_type=Path)
PACES = ("step", "max", "recorded")


def say(text: str) -> None:
    """Prints a line for people on stderr: stdout is for results."""
    click.echo(text, err=True)


class JUnitCommand(click.Command):
    """A command whose --junit file reports a failure or an error whenever the exit code is not 0."""

    def make_context(self, info_name: str | None, args: list[str], *more: Any, **extra: Any) -> click.Context:
        words = list(args)  # parsing consumes the list
        try:
            return super().make_context(info_name, args, *more, **extra)
        except click.ClickException as error:
            with contextlib.suppress(UserError):
                _write(_junit_of(words), info_name or "", error.format_message())
            raise

    def invoke(self, ctx: click.Context) -> Any:
        junit, name, began = ctx.params["junit"], ctx.params["path"].name, time.monotonic()
        _write(junit, name, "it did not finish")  # before the run, because the run may be killed
        try:
            return super().invoke(ctx)
        except BaseException as error:
            what = "interrupted" if isinstance(error, KeyboardInterrupt) else str(error) or type(error).__name__
            with contextlib.suppress(UserError):
                _write(junit, name, what, time.monotonic() - began)
            if not isinstance(error, run.ReplayFailed):
                raise
            say(f"error: replay of {ctx.params['path']}: {error}")
            return 1


def _junit_of(words: list[str]) -> Path | None:
    """The value of --junit, even if the other arguments are invalid."""
    for word, following in itertools.zip_longest(words, words[1:], fillvalue=""):
        if word == "--junit" or word.startswith("--junit="):
            found = following if word == "--junit" else word.partition("=")[2]
            return Path(found) if found else None
    return None


def _write(junit: Path | None, name: str, error: str, seconds: float = 0.0) -> None:
    if junit is not None:
        write_junit(junit, name, [], error, seconds)


@click.command(cls=JUnitCommand)
@click.argument("path", type=PATH, metavar="SEQ")
@click.option("--scene", type=PATH, metavar="S", help="The light field.  [default: the demo's]")
@click.option("--pace", default="step", show_default=True, metavar="step|max|recorded|HZ", help="When frames are played.",
              shell_complete=lambda *_: [CompletionItem(pace) for pace in PACES])  # fmt: skip
@click.option("--out", type=PATH, metavar="DIR", help="Folder for report.json, trace.jsonl and pictures.")
@click.option("--expect", type=PATH, metavar="REF", help="Compare with this folder, written by --out or --update.")
@click.option("--update", is_flag=True, help="Write the reference of --expect instead of comparing with it.")
@click.option("--junit", type=PATH, metavar="FILE", help="Write the outcome as JUnit XML.")
@with_config
def replay(
    path: Path,
    scene: Path | None,
    pace: str,
    out: Path | None,
    expect: Path | None,
    update: bool,
    junit: Path | None,
    sets: tuple[str, ...],
    config_file: str | None,
) -> int:
    """Run SEQ through the pipeline; exit code 0: as expected, 1: it differs, 2: bad input."""
    began = time.monotonic()
    _check(pace, out, expect, update)
    sequence = open_sequence(path)
    if not sequence.complete:
        say(f"{path} was cut off during recording: replaying its {len(sequence.packets)} whole frames")
    config = run.replay_config(sequence, config_file, sets)
    if expect is not None:
        run.check_out(expect) if update else read_report(expect)
    with _folder(out) as folder:
        run.check_out(folder)
        field = opened(scene, config)
        if expect is not None and not update:
            check_reference(expect, {"sequence": about_sequence(sequence), "scene": about_scene(field)})
        run.clear_out(folder)
        kept = pace == "step" and (out is not None or expect is not None)
        report = run.replay(sequence, field, config, pace, folder, kept, say)
        _summary(report)
        compared = Comparison([], [])
        if expect is not None and update:
            run.update_reference(expect, folder)
            say(f"reference written to {expect}")
        elif expect is not None:
            compared = compare(expect, folder)
            if compared.differences and out is None:
                say("--out DIR keeps the pictures that show a difference")
    for note in compared.notes:
        click.echo(note)
    for difference in compared.differences:
        click.echo(f"differs: {difference}")
    against = expect is not None and not update
    if against and not compared.differences:
        click.echo(f"matches {expect}")
    sys.stdout.flush()  # detects a closed pipe here, while it still counts as a failure
    if junit is not None:
        write_junit(junit, path.name, cases_of(against, compared.differences), "", time.monotonic() - began)
    return 1 if compared.differences else 0


def _check(pace: str, out: Path | None, expect: Path | None, update: bool) -> None:
    """Raises UserError for options that exclude each other."""
    if pace != "step":
        try:
            parse_source(f"file:sequence?pace={pace}")
        except UserError:
            close = difflib.get_close_matches(pace, PACES, 1, 0.5)
            hint = f" (did you mean {close[0]!r}?)" if close else ""
            remedy = "step is the fastest that gives the same results every time; max plays without waiting, 30 plays at 30 Hz"
            raise UserError(f"--pace {pace}: not {', '.join(PACES)} or a rate in Hz{hint}", remedy) from None
    if update and expect is None:
        raise UserError("--update needs a reference", "name it with --expect REF")
    if expect is not None and out is not None and os.path.realpath(expect) == os.path.realpath(out):
        raise UserError(f"--out and --expect are both {out}", "use two folders; --update writes the reference")
    if expect is not None and pace not in STEADY:
        raise UserError(f"--expect with --pace {pace}: results depend on the clock", "compare with --pace step or max")


@contextlib.contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    if out is not None:
        yield out
        return
    try:
        made = tempfile.TemporaryDirectory(prefix="lfpipe-replay-", ignore_cleanup_errors=True)
    except OSError as error:
        raise UserError(f"{tempfile.gettempdir()}: {error.strerror}", "name a folder for the results: --out DIR") from None
    with made as folder:
        yield Path(folder)


def _summary(report: dict[str, Any]) -> None:
    counts, latency = report["counts"], report["latency"]["end_to_end"]
    dropped = sum(counts["dropped"].values())
    name = report["sequence"]["name"]
    click.echo(f"{name}: {counts['frames']} frames, {counts['faces']} with a face, {counts['composed']} composed")
    click.echo(f"{report['rate_hz']:.1f} frames/s, {dropped} dropped, read to shown p50 {latency.get('p50_ms', 0):.2f} ms")
    for name, error in (report["truth_error"] or {}).items():
        if error:
            click.echo(f"eyes {name}: {error['rms_px']:.2f} px rms error, {error['max_px']:.2f} px at most")
    for name, digest in (report["digests"] or {}).items():
        click.echo(f"{name:<8} {digest}")
    sys.stdout.flush()
