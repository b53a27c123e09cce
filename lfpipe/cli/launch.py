"""From what a person typed to a running session: everything is checked before the first process starts."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import click

from lfpipe import config as config_module
from lfpipe.config import Config, SessionOptions
from lfpipe.errors import UserError
from lfpipe.supervisor import rundir
from lfpipe.transport.session import Session, default_name

if TYPE_CHECKING:
    from lfpipe.capture.open_source import Checked
    from lfpipe.supervisor.outcome import Outcome

DEMO_S = 10.0  # of the demo where nobody can see it


@attrs.frozen
class Wish:
    """The arguments of `lfpipe up`."""

    scene: Path | None
    camera: str | None
    display: str | None
    duration_s: float | None
    trace: Path | None
    demo: bool
    session_name: str | None
    sets: tuple[str, ...]
    config_file: str | None


@attrs.frozen
class Prepared:
    """A session that can start. files: what it will leave, for the last words. hold: keeps the pack in the cache."""

    config: Config
    options: SessionOptions
    duration_s: float | None
    files: tuple[Path, ...]
    hold: object


def say(text: str) -> None:
    """A line for the person, on stderr: stdout is for results."""
    click.echo(text, err=True)


def up(wish: Wish) -> int:
    """Runs a session; returns the exit code. Raises UserError before any process starts."""
    from lfpipe.observe.latency_table import latency_table
    from lfpipe.supervisor.supervisor import Supervisor

    session = Session(wish.session_name or default_name())
    if session.name in rundir.running():
        rundir.release(session, rundir.acquire(session))  # says who has it
    prepared = prepare(wish)
    outcome = Supervisor(session, prepared.config, prepared.options, say).run(prepared.duration_s)
    latency_table(outcome.final)
    for path in prepared.files:
        if path.exists():
            click.echo(f"{path.stat().st_size / 1e6:8.2f} MB  {path}")
    if outcome.failure is None:
        say(outcome.reason)
    return exit_code(outcome)


def exit_code(outcome: Outcome) -> int:
    """0, or 1 with what failed said. Raises UserError where that is the user's to mend."""
    if outcome.failure is None:
        return 0
    if outcome.user_error:
        raise UserError(outcome.failure, outcome.remedy)
    say(f"error: {outcome.failure}\n  remedy: {outcome.remedy}")
    return 1


def prepare(wish: Wish) -> Prepared:
    """Checks the wish as a whole, packs the scene where that is still to be done, and prints what was chosen."""
    from lfpipe.cli import chosen
    from lfpipe.cli.packed import packed
    from lfpipe.render.geometry import check_geometry
    from lfpipe.render.open_display import has_display
    from lfpipe.scene.plan import make_plan
    from lfpipe.scene.summary import summarize

    unseen = wish.demo and wish.display is None and not has_display()
    halved = ("render.rate_hz=30",) if unseen else ()  # lossless video is large
    config = config_module.load(wish.config_file, (*halved, *wish.sets))
    out = Path("lfpipe-demo")
    display = wish.display or (f"file:{out / 'demo.mkv'}" if unseen else "window")
    if unseen:
        try:
            out.mkdir(exist_ok=True)
        except OSError as error:
            remedy = "run the demo in a directory that you may write to, or with --display none"
            raise UserError(f"{out}/: {error.strerror}", remedy) from None
        say(f"no screen here: the demo runs {wish.duration_s or DEMO_S:g} s into {out}/")
    camera = _checked(wish, config, display)
    field = packed(wish.scene, config.scene)
    scene = summarize(field, config.scene)
    check_geometry(config, scene)
    plan = make_plan(field, config)
    still = out / "demo.png" if unseen else None
    options = SessionOptions(
        scene=scene,
        source=camera.text,
        source_hz=camera.rate_hz,
        jpeg_px=camera.jpeg_px,
        tracking=plan.needs_tracking,
        display=display,
        trace=str(wish.trace.resolve()) if wish.trace else "",
        still=str(still.resolve()) if still else "",
        lossless="pace=max" in camera.text,
    )
    for line in chosen.lines(config, field, plan, camera.text, display):
        say(line)
    duration_s = wish.duration_s or (DEMO_S if unseen else None)
    video = Path(display.removeprefix("file:")) if display.startswith("file:") else None
    files = tuple(path for path in (video, still, wish.trace) if path is not None)
    return Prepared(config, options, duration_s, files, field.hold)


def _checked(wish: Wish, config: Config, display: str) -> Checked:
    """The source of frames; every mistake of the wish in one UserError."""
    from lfpipe.capture.open_source import Checked, check_source
    from lfpipe.render.open_display import check_display
    from lfpipe.trace import check_trace

    camera = wish.camera or config.camera.source or ("demo" if wish.demo else "")
    errors: list[UserError] = []
    single = False  # one view needs no eyes, and no camera

    def attempt(check: Callable[[], Any]) -> Any:
        try:
            return check()
        except UserError as error:
            errors.append(error)
            return None

    if wish.scene is not None:
        scene = wish.scene
        rows, cols = attempt(lambda: _grid(scene, config)) or (0, 0)
        single = rows * cols == 1
    elif not wish.demo:
        errors.append(UserError("no SCENE given", "a folder of views, or --demo for a made one"))
    found = Checked("", 0.0) if single else attempt(lambda: check_source(camera, config.camera))
    attempt(lambda: check_display(display, str(config.screen.monitor)))
    if wish.trace is not None:
        trace = wish.trace
        attempt(lambda: check_trace(trace))
    if len(errors) > 1:
        raise UserError("\nerror: ".join(map(str, errors)))
    if errors:
        raise errors[0]
    assert isinstance(found, Checked)
    return found


def _grid(scene: Path, config: Config) -> tuple[int, int]:
    """Rows and columns of the scene; a packed one is not looked at again."""
    from lfpipe.scene.cache import find_pack
    from lfpipe.scene.manifest import DamagedPackError, read_manifest

    if pack := find_pack(scene, config.scene):
        with contextlib.suppress(DamagedPackError):  # it will be made again
            manifest = read_manifest(pack)
            return manifest["rows"], manifest["cols"]
    from lfpipe.scene.layouts import describe

    source = describe(scene, config.scene)
    return source.rows, source.cols


if sys.platform != "linux":  # FIFOs, PDEATHSIG, posix_fallocate, V4L2
    raise UserError(f"lfpipe runs on Linux, this is {sys.platform}", "a Linux machine or virtual machine")
