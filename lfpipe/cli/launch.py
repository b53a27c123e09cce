"""`lfpipe up`, from its arguments to a running session. All checks run before the first process starts."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import click

from lfpipe import config as configuration
from lfpipe.capture.open_source import MOUSE, CheckedSource, NoCamera, camera_name, check_source
from lfpipe.capture.spec import playing_once, source_file
from lfpipe.cli.kiosk import check_exhibition, until_it_ends
from lfpipe.cli.progress import progress
from lfpipe.cli.startup_summary import loop_lines, sharing_lines, size_line, startup_lines
from lfpipe.config import Config, SessionOptions
from lfpipe.config.user_files import has_key, with_measured_focal
from lfpipe.errors import UserError
from lfpipe.files.output import check_outputs
from lfpipe.files.video_writer import require_encoder
from lfpipe.host.files import exists
from lfpipe.observe.state_text import print_state
from lfpipe.render.display import check_display, has_display
from lfpipe.render.plan import make_plan
from lfpipe.scene.open_scene import Opened, Packing, open_scenes
from lfpipe.scene.pack import summarize
from lfpipe.scene.recent_scenes import remember_scene
from lfpipe.share.target import check_targets
from lfpipe.supervisor import rundir
from lfpipe.supervisor.live_session import Outcome
from lfpipe.supervisor.supervisor import run_session
from lfpipe.track import models
from lfpipe.transport.session import Session, default_name

DEMO_S = 10.0  # length of the demo without a screen
DEMO_FOLDER = Path("lfpipe-demo")
WINDOWS = ("window", "fullscreen")


@attrs.frozen
class UpArguments:
    """The arguments of `lfpipe up`. kiosk: the code that ends an exhibition. start: begin with the scenes' thumbnails."""

    scenes: tuple[Path, ...] = ()
    camera: str | None = None
    display: str | None = None
    duration_s: float | None = None
    trace: Path | None = None
    demo: bool = False
    share: tuple[str, ...] = ()
    no_picture: bool = False
    session_name: str = attrs.field(factory=default_name)
    sets: tuple[str, ...] = ()
    config_file: str | None = None
    kiosk: str | None = None
    start: bool = False
    force: bool = False


@attrs.frozen
class SessionPlan:
    """A session that can start. files: its outputs, listed at its end. hold: keeps the pack in the cache. packing: the packer,
    while it works on the scene's disparity."""

    config: Config
    options: SessionOptions
    duration_s: float | None
    files: tuple[Path, ...] = ()
    hold: object = None
    packing: Packing | None = None


def say(text: str) -> None:
    """Prints a line for people on stderr: stdout is for results."""
    click.echo(text, err=True)


def launch(arguments: UpArguments) -> int:
    """Runs a session; returns the exit code. Raises UserError before any process starts.

    An exhibition that fails after it has run restarts until it succeeds: it has no operator.
    """
    session = Session(arguments.session_name)
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
    with contextlib.ExitStack() as steps:
        if plan.packing is not None:
            steps.callback(plan.packing.close)
        outcome = run_session(session, plan.config, plan.options, say, plan.duration_s, plan.packing)
    print_state(outcome.final)
    for path in filter(exists, plan.files):
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
    """Checks all arguments, packs the scene unless it is packed, and prints the settings in force. Raises UserError."""
    return _prepare_tracking(arguments) if arguments.no_picture else _prepare_pictures(arguments)


def _prepare_tracking(arguments: UpArguments) -> SessionPlan:
    """A session that tracks eyes and shows nothing."""
    given = {"SCENE": arguments.scenes, "--display": arguments.display, "--trace": arguments.trace}
    if pointless := [name for name, value in given.items() if value]:
        raise UserError(f"--no-picture with {', '.join(pointless)}: nothing is shown", "leave out one or the other")
    config = configuration.load(arguments.config_file, arguments.sets)
    _, camera, share = _checked(arguments, config, "none", None)
    config = with_engine(_with_measured_focal(config, camera))
    say(f"camera  {camera.text}; eyes by {config.track.engine}, filter {config.track.filter}; no picture")
    for line in sharing_lines(share):
        say(line)
    return SessionPlan(config, attrs.evolve(camera.options, show=False, share=share), arguments.duration_s)


def _prepare_pictures(arguments: UpArguments) -> SessionPlan:
    records_itself = arguments.demo and arguments.display is None and not has_display()
    display = _demo_display() if records_itself else arguments.display or ("fullscreen" if arguments.kiosk else "window")
    video = Path(display.removeprefix("file:")) if display.startswith("file:") else None
    still = DEMO_FOLDER / "demo.png" if records_itself else None
    duration_s = arguments.duration_s or (DEMO_S if records_itself else None)
    check_exhibition(arguments.kiosk, display)
    halved = ("render.rate_hz=30",) if records_itself else ()  # lossless video is large
    config = configuration.load(arguments.config_file, (*halved, *arguments.sets))

    def opened() -> Opened:
        with progress() as bar:
            return open_scenes(arguments.scenes, config.scene, bar, complete=video is not None)

    opening, camera, share = _checked(arguments, config, display, opened if arguments.scenes or arguments.demo else None)
    assert opening is not None
    scenes, scene = opening.scenes, summarize(opening.field)
    tracking = scene.needs_tracking and not camera.is_mouse
    config = _with_measured_focal(config, camera)
    config = with_engine(config) if tracking else config
    if arguments.scenes and arguments.kiosk is None and not arguments.start:
        remember_scene(scenes[0])
    options = attrs.evolve(
        camera.options,
        scene=scene,
        tracking=tracking,
        display=display,
        kiosk=arguments.kiosk or "",
        playlist=tuple(map(_absolute, scenes)) if len(scenes) > 1 or arguments.start else (),
        start=arguments.start,
        ask_glasses=_is_first_start(arguments, display),
        trace=_absolute(arguments.trace),
        still=_absolute(still),
        share=share,
    )
    for line in startup_lines(config, opening.field, make_plan(opening.field, config), camera.text, display):
        say(line)
    for line in (*([] if camera.is_mouse else loop_lines(config, camera.text, display)), *sharing_lines(share)):
        say(line)
    if len(scenes) > 1:
        say(f"scenes  {len(scenes)}: Tab, Page Up and Page Down show the others, as does `lfpipe ctl load --next`")
    if video is not None:
        rate_hz = (camera.rate_hz if config.render.clock == "camera" else None) or config.render.nominal_hz
        say(size_line(video, opening.field.width_px * opening.field.height_px, rate_hz, duration_s))
    files = tuple(path for path in (video, still, arguments.trace) if path is not None)
    return SessionPlan(config, options, duration_s, files, opening.field.hold, opening.packing)


def _absolute(path: Path | None) -> str:
    return "" if path is None else str(path.resolve())


def _demo_display() -> str:
    """Creates the folder to which the demo records itself without a screen. Returns its video as a display: small and playable
    anywhere if there is an encoder for that. Raises UserError."""
    try:
        DEMO_FOLDER.mkdir(exist_ok=True)
    except OSError as error:
        remedy = "run the demo in a directory that you may write to, or with --display none"
        raise UserError(f"{DEMO_FOLDER}/: {error.strerror}", remedy) from None
    say(f"no screen here: the demo records itself in {DEMO_FOLDER}/")
    try:
        require_encoder()
    except UserError as error:
        say(f"the demo's video is lossless and large: {error.message}; {error.remedy}")
        return f"file:{DEMO_FOLDER / 'demo.mkv'}"
    return f"file:{DEMO_FOLDER / 'demo.mp4'}"


def _is_first_start(arguments: UpArguments, display: str) -> bool:
    """Whether a person opens a window for the first time: no glasses were chosen yet, and no option is given that a script
    would."""
    scripted = arguments.sets or arguments.config_file or arguments.duration_s or arguments.trace or arguments.kiosk is not None
    return not scripted and display in WINDOWS and not has_key(configuration.user_file(), "render", "anaglyph")


def with_engine(config: Config) -> Config:
    """Returns config with an engine that this machine has. Fetches its networks if they are missing. Raises UserError."""
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
    camera = arguments.camera or config.camera.source or ("demo" if arguments.demo else "")
    source = CheckedSource("", 0.0) if single else attempt(lambda: _source(camera, display, config, arguments.kiosk is not None))
    attempt(lambda: check_display(display, str(config.screen.monitor)))
    share = attempt(lambda: check_targets(arguments.share))
    if single and arguments.share:
        remedy = "`lfpipe up --no-picture --share TARGET` tracks without a scene"
        errors.append(UserError(f"--share with {arguments.scenes[0]}: a single view needs no eyes, so none are tracked", remedy))
    video = Path(display.removeprefix("file:")).expanduser() if display.startswith("file:") else None
    outputs = {"--display": video, "--trace": arguments.trace}
    inputs = [path for path in (*arguments.scenes, source_file(camera)) if path is not None]
    attempt(lambda: check_outputs(outputs, inputs, arguments.force))
    if errors and opening is not None and opening.packing is not None:
        opening.packing.close()
    if len(errors) > 1:
        raise UserError("\nerror: ".join(map(str, errors)))
    if errors:
        raise errors[0]
    return opening, source, share


def _source(camera: str, display: str, config: Config, kiosk: bool) -> CheckedSource:
    """The source of frames; without a camera, the mouse over a window, but not in an exhibition, which has none. A file whose
    pictures go to a file plays once. Raises UserError."""
    has_mouse = display in WINDOWS and not kiosk
    if camera == MOUSE:
        if has_mouse:
            return CheckedSource(MOUSE, 0.0)
        where = "--kiosk" if kiosk else f"--display {display}"
        raise UserError(
            f"--camera mouse with {where}: there is no mouse", "use --display window, or another source: --camera demo"
        )
    try:
        return check_source(playing_once(camera) if camera and display.startswith("file:") else camera, config.camera)
    except NoCamera:
        if not has_mouse:
            raise
        say("no camera: move the mouse to look around")
        return CheckedSource(MOUSE, 0.0)


def _with_measured_focal(config: Config, camera: CheckedSource) -> Config:
    """Returns config with the focal length that `lfpipe calibrate` measured for this camera."""
    return with_measured_focal(config, camera_name(camera.text)) if camera.text and not camera.is_mouse else config
