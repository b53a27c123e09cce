"""`lfpipe up`, from its arguments to a running session. All checks run before the first process starts."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import click

from lfpipe import config as config_module
from lfpipe.config import Config, SessionOptions
from lfpipe.errors import UserError
from lfpipe.host.paths import exists
from lfpipe.supervisor import rundir
from lfpipe.transport.session import Session, default_name

if TYPE_CHECKING:
    from lfpipe.capture.open_source import CheckedSource
    from lfpipe.render.plan import Plan
    from lfpipe.scene.open_scene import Opened, Packing
    from lfpipe.supervisor.live_session import Outcome

DEMO_S = 10.0  # length of the demo without a screen


@attrs.frozen
class UpArguments:
    """The arguments of `lfpipe up`. scenes: all of them; scene: the first. start: begin with their thumbnails."""

    scene: Path | None = None
    camera: str | None = None
    display: str | None = None
    duration_s: float | None = None
    trace: Path | None = None
    demo: bool = False
    share: tuple[str, ...] = ()
    no_picture: bool = False
    session_name: str | None = None
    sets: tuple[str, ...] = ()
    config_file: str | None = None
    scenes: tuple[Path, ...] = ()
    kiosk: str | None = None
    visits: Path | None = None
    start: bool = False
    force: bool = False


@attrs.frozen
class SessionPlan:
    """A session that can start. files: its outputs, listed at its end; video: the output that grows with every picture.
    hold: keeps the pack in the cache. packing: the packer, while it works on the scene's disparity."""

    config: Config
    options: SessionOptions
    duration_s: float | None
    files: tuple[Path, ...]
    hold: object
    video: Path | None = None
    packing: Packing | None = None


def say(text: str) -> None:
    """Prints a line for people on stderr: stdout is for results."""
    click.echo(text, err=True)


def up(arguments: UpArguments) -> int:
    """Runs a session; returns the exit code. Raises UserError before any process starts.

    An exhibition that fails after it has run restarts until it succeeds: it has no operator.
    """
    from lfpipe.cli.kiosk import until_it_ends

    session = Session(arguments.session_name or default_name())
    plan = _planned(session, arguments)
    if arguments.kiosk is None:
        return _run(session, plan)
    return until_it_ends(lambda: _run(session, plan), lambda: _run(session, _planned(session, arguments)))


def _planned(session: Session, arguments: UpArguments) -> SessionPlan:
    if session.name in rundir.running():
        rundir.release(session, rundir.acquire(session))  # raises the error with the remedy
    return prepare(arguments)


def _run(session: Session, plan: SessionPlan) -> int:
    """Runs one session; returns the exit code. Raises UserError if the user can fix what ended it."""
    from lfpipe.cli.progress import growing_file
    from lfpipe.observe.latency_table import latency_table
    from lfpipe.supervisor.supervisor import Supervisor

    with growing_file(plan.video), contextlib.ExitStack() as steps:
        if plan.packing is not None:
            steps.callback(plan.packing.close)
        outcome = Supervisor(session, plan.config, plan.options, say, plan.packing).run(plan.duration_s)
    latency_table(outcome.final)
    for path in plan.files:
        if exists(path):
            click.echo(f"{path.stat().st_size / 1e6:8.2f} MB  {path}")
    if outcome.failure is None:
        say(outcome.reason)
    return exit_code(outcome)


def exit_code(outcome: Outcome) -> int:
    """Returns 0, or 1 after printing what failed. Raises UserError if the user can fix it."""
    if outcome.failure is None:
        return 0
    if outcome.user_error:
        raise UserError(outcome.failure, outcome.remedy)
    say(f"error: {outcome.failure}\n  remedy: {outcome.remedy}")
    return 1


def prepare(arguments: UpArguments) -> SessionPlan:
    """See `_prepare_pictures`; without a picture only camera and targets are prepared. Raises UserError."""
    return _prepare_tracking(arguments) if arguments.no_picture else _prepare_pictures(arguments)


def _prepare_tracking(arguments: UpArguments) -> SessionPlan:
    """A session that tracks eyes and shows nothing."""
    from lfpipe.cli.startup_summary import sharing_lines

    given = {"SCENE": arguments.scene, "--display": arguments.display, "--trace": arguments.trace}
    if pointless := [name for name, value in given.items() if value is not None]:
        raise UserError(f"--no-picture with {', '.join(pointless)}: nothing is shown", "leave out one or the other")
    config = config_module.load(arguments.config_file, arguments.sets)
    _, camera, share = _checked(arguments, config, "none", None)
    config = _with_measured_focal(config, camera)
    config = _with_engine(config)
    options = attrs.evolve(camera.options, show=False, share=share)
    say(f"camera  {camera.text}; eyes by {config.track.engine}, filter {config.track.filter}; no picture")
    for line in sharing_lines(share):
        say(line)
    return SessionPlan(config, options, arguments.duration_s, (), None)


@attrs.frozen
class _Outputs:
    """Where the pictures go. video, still: files that display writes. no_screen: a demo that records itself."""

    display: str
    video: Path | None
    still: Path | None
    duration_s: float | None
    no_screen: bool


def _chosen_outputs(arguments: UpArguments) -> _Outputs:
    """The display; without a screen, the demo's own folder, which is created. Raises UserError."""
    from lfpipe.cli.kiosk import check_exhibition
    from lfpipe.render.display import has_display

    no_screen = arguments.demo and arguments.display is None and not has_display()
    out = Path("lfpipe-demo")
    display = arguments.display or (f"file:{out / _demo_video()}" if no_screen else "fullscreen" if arguments.kiosk else "window")
    check_exhibition(arguments.kiosk, arguments.visits is not None, display)
    video = Path(display.removeprefix("file:")) if display.startswith("file:") else None
    if not no_screen:
        return _Outputs(display, video, None, arguments.duration_s, no_screen)
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        remedy = "run the demo in a directory that you may write to, or with --display none"
        raise UserError(f"{out}/: {error.strerror}", remedy) from None
    duration_s = arguments.duration_s or DEMO_S
    say(f"no screen here: the demo runs for {duration_s:g} s and writes to {out}/")
    return _Outputs(display, video, out / "demo.png", duration_s, no_screen)


def _prepare_pictures(arguments: UpArguments) -> SessionPlan:
    """Checks all arguments, packs the scene unless it is packed, and prints the settings in force."""
    from lfpipe.cli.progress import progress
    from lfpipe.render.geometry import check_geometry
    from lfpipe.render.plan import make_plan
    from lfpipe.scene.open_scene import open_scenes
    from lfpipe.scene.pack import summarize
    from lfpipe.scene.recent_scenes import remember_scene

    outputs = _chosen_outputs(arguments)
    halved = ("render.rate_hz=30",) if outputs.no_screen else ()  # lossless video is large
    config = config_module.load(arguments.config_file, (*halved, *arguments.sets))

    def opened() -> Opened:
        with progress() as bar:
            return open_scenes(arguments.scenes, config.scene, bar, complete=outputs.video is not None)

    has_scene = bool(arguments.scenes or arguments.demo)
    opening, camera, share = _checked(arguments, config, outputs.display, opened if has_scene else None)
    assert opening is not None
    scenes, scene = opening.scenes, summarize(opening.field)
    tracking = scene.needs_tracking and not camera.is_mouse
    config = _with_measured_focal(config, camera)
    config = _with_engine(config) if tracking else config
    check_geometry(config, scene)
    if arguments.scenes and arguments.kiosk is None and not arguments.start:
        remember_scene(scenes[0])

    def whole(path: Path | None) -> str:
        return "" if path is None else str(path.resolve())

    options = attrs.evolve(
        camera.options,
        scene=scene,
        tracking=tracking,
        display=outputs.display,
        kiosk=arguments.kiosk or "",
        visits=whole(arguments.visits),
        playlist=tuple(map(whole, scenes)) if len(scenes) > 1 or arguments.start else (),
        start=arguments.start,
        ask_glasses=_is_first_start(arguments, outputs.display),
        trace=whole(arguments.trace),
        still=whole(outputs.still),
        share=share,
    )
    _announce(config, opening, make_plan(opening.field, config), camera, outputs, share)
    files = tuple(path for path in (outputs.video, outputs.still, arguments.trace) if path is not None)
    return SessionPlan(config, options, outputs.duration_s, files, opening.field.hold, outputs.video, opening.packing)


def _announce(
    config: Config, opening: Opened, plan: Plan, camera: CheckedSource, outputs: _Outputs, share: tuple[str, ...]
) -> None:
    """Prints the settings in force."""
    from lfpipe.cli.startup_summary import loop_lines, sharing_lines, size_line, startup_lines

    field, display = opening.field, outputs.display
    loop = [] if camera.is_mouse else loop_lines(config, camera.text, display)
    for line in (*startup_lines(config, field, plan, camera.text, display), *loop, *sharing_lines(share)):
        say(line)
    if (count := len(opening.scenes)) > 1:
        say(f"scenes  {count}: Tab, Page Up and Page Down show the others, as does `lfpipe ctl load --next`")
    if outputs.video is not None:
        camera_hz = camera.rate_hz if config.render.clock == "camera" else None
        say(size_line(outputs.video, field.width_px * field.height_px, camera_hz or config.render.nominal_hz, outputs.duration_s))


def _is_first_start(arguments: UpArguments, display: str) -> bool:
    """Whether a person opens a window for the first time: no glasses were chosen yet, and no option is given that a script
    would."""
    scripted = arguments.sets or arguments.config_file or arguments.duration_s or arguments.trace or arguments.kiosk is not None
    if scripted or display not in ("window", "fullscreen"):
        return False
    from lfpipe.config.user_settings import has_key

    return not has_key(config_module.user_file(), "render", "anaglyph")


def _demo_video() -> str:
    """The name of the demo's video: small and playable anywhere if there is an encoder for that."""
    from lfpipe.files.h264 import encoder_name

    try:
        encoder_name()
    except UserError as error:
        say(f"the demo's video is lossless and large: {error.message}; {error.remedy}")
        return "demo.mkv"
    return "demo.mp4"


def _with_engine(config: Config) -> Config:
    """Returns config with an engine that this machine has. Fetches its networks if they are missing. Raises UserError."""
    from lfpipe.track import models

    if config.track.engine == "mediapipe" and models.package_folder() is None:
        say("engine  mediapipe is not installed here: using track.engine=litert, which runs the same landmark network")
        config = attrs.evolve(config, track=attrs.evolve(config.track, engine="litert"))
    if config.track.engine == "litert" and models.missing_models():
        models.fetch_models(say)
    return config


def _checked(
    arguments: UpArguments, config: Config, display: str, opened: Callable[[], Opened] | None
) -> tuple[Opened | None, CheckedSource, tuple[str, ...]]:
    """The scene, the source of frames, and the targets to share with. Raises one UserError for all mistakes in the arguments."""
    from lfpipe.capture.open_source import CheckedSource
    from lfpipe.capture.spec import source_file
    from lfpipe.files.output import check_outputs
    from lfpipe.render.display import check_display
    from lfpipe.share.target import check_targets

    camera = arguments.camera or config.camera.source or ("demo" if arguments.demo else "")
    errors: list[UserError] = []

    def attempt(check: Callable[[], Any]) -> Any:
        try:
            return check()
        except UserError as error:
            errors.append(error)
            return None

    if opened is None and not arguments.no_picture:
        errors.append(UserError("no SCENE given", "name a folder of views, or use --demo for the built-in scene"))
    opening: Opened | None = None if opened is None else attempt(opened)
    # a single view needs no eyes, and no camera
    single = opening is not None and opening.field.rows * opening.field.cols == 1 and len(opening.scenes) < 2
    found = CheckedSource("", 0.0) if single else attempt(lambda: _source(camera, display, config, arguments.kiosk is not None))
    attempt(lambda: check_display(display, str(config.screen.monitor)))
    share = attempt(lambda: check_targets(arguments.share))
    if single and arguments.share:
        remedy = "`lfpipe up --no-picture --share TARGET` tracks without a scene"
        errors.append(UserError(f"--share with {arguments.scene}: a single view needs no eyes, so none are tracked", remedy))
    video = Path(display.removeprefix("file:")).expanduser() if display.startswith("file:") else None
    outputs = {"--display": video, "--trace": arguments.trace, "--visits": arguments.visits}
    inputs = [path for path in (*arguments.scenes, source_file(camera)) if path is not None]
    attempt(lambda: check_outputs(outputs, inputs, arguments.force))
    if errors and opening is not None and opening.packing is not None:
        opening.packing.close()
    if len(errors) > 1:
        raise UserError("\nerror: ".join(map(str, errors)))
    if errors:
        raise errors[0]
    assert isinstance(found, CheckedSource)
    return opening, found, share


def _source(camera: str, display: str, config: Config, kiosk: bool) -> CheckedSource:
    """The source of frames; without a camera, the mouse over a window, but not in an exhibition, which has none. Raises
    UserError."""
    from lfpipe.capture.open_source import MOUSE, CheckedSource, NoCamera, check_source

    has_mouse = display in ("window", "fullscreen") and not kiosk
    if camera == MOUSE:
        if has_mouse:
            return CheckedSource(MOUSE, 0.0)
        where = "--kiosk" if kiosk else f"--display {display}"
        raise UserError(
            f"--camera mouse with {where}: there is no mouse", "use --display window, or another source: --camera demo"
        )
    try:
        return check_source(_once(camera, display), config.camera)
    except NoCamera:
        if not has_mouse:
            raise
        say("no camera: move the mouse to look around")
        return CheckedSource(MOUSE, 0.0)


def _once(camera: str, display: str) -> str:
    """The source. If pictures go to a file, a source file without ?loop= plays once and then ends the session."""
    from lfpipe.capture.spec import playing_once

    return playing_once(camera) if camera and display.startswith("file:") else camera


def _with_measured_focal(config: Config, camera: CheckedSource) -> Config:
    """Returns config with the focal length that `lfpipe calibrate` measured for this camera."""
    from lfpipe.capture.open_source import camera_name
    from lfpipe.config.camera_file import with_measured_focal

    return with_measured_focal(config, camera_name(camera.text)) if camera.text and not camera.is_mouse else config
