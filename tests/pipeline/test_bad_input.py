"""Errors are reported before any process starts: the thing, the value, the remedy, exit code 2, no traceback."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from lfpipe.cli import cli
from lfpipe.errors import UserError
from tests.world import World, write_scene


def view(path: Path, height: int = 48, width: int = 64) -> None:
    cv2.imwrite(str(path), np.full((height, width, 3), 90, np.uint8))


def unequal(root: Path) -> list[str | Path]:
    folder = write_scene(root / "unequal")
    for number, path in enumerate(sorted(folder.iterdir())):  # a single odd one would only be left out
        view(path, 48 + number, 64)
    return ["up", folder, "--camera", "demo", "--display", "none"]


def doubled(root: Path) -> list[str | Path]:
    folder = write_scene(root / "doubled")
    view(folder / "view_1_2.png")
    return ["up", folder, "--camera", "demo", "--display", "none"]


def truncated(root: Path) -> list[str | Path]:
    folder = write_scene(root / "truncated")
    whole = (folder / "view_02_00.png").read_bytes()
    (folder / "view_02_00.png").write_bytes(whole[: len(whole) // 2])
    return ["up", folder, "--camera", "demo", "--display", "none"]


def empty(root: Path) -> list[str | Path]:
    (root / "empty").mkdir()
    return ["up", root / "empty"]


def no_video(root: Path) -> list[str | Path]:
    (root / "notes.mp4").write_text("not a video")
    return ["up", write_scene(root / "a"), "--camera", f"file:{root / 'notes.mp4'}"]


def good(*args: str | Path) -> Callable[[Path], list[str | Path]]:
    return lambda root: ["up", write_scene(root / "good"), *args]


# everything is wrong, and all errors are reported
EVERYTHING = ["up", "nowhere", "--camera", "file:nofile.mp4", "--display", "windw", "--trace", "/proc/x/t.jsonl"]
CASES: dict[str, tuple[Callable[[Path], list[str | Path]], tuple[str, ...]]] = {
    "missing scene": (lambda root: ["up", root / "nowhere", "--camera", "demo"], ("nowhere",)),
    "no scene": (lambda root: ["up"], ("SCENE", "--demo")),
    "empty folder": (empty, ("empty",)),
    "unequal views": (unequal, ("view_00_00.png", "64x48", "64x5")),
    "two files for one view": (doubled, ("view_1_2.png", "view_01_02.png", "move")),
    "unreadable image": (truncated, ("view_02_00.png",)),
    "no video": (no_video, ("notes.mp4",)),
    "missing video": (good("--camera", "file:nowhere.mp4"), ("nowhere.mp4",)),
    "camera gone": (good("--camera", "camera:/dev/video97"), ("97",)),
    "unknown source": (good("--camera", "fil:x.mp4"), ("fil:x.mp4", "did you mean")),
    "unknown key": (good("--set", "render.alpa_px=3"), ("render.alpa_px", "did you mean 'render.alpha_px'")),
    "all errors at once": (good("--set", "track.mean_k=0", "--set", "camera.rate_hz=x"), ("track.mean_k", "camera.rate_hz")),
    "no key": (good("--set", "render"), ("KEY=VALUE",)),
    "unknown preset": (good("--config", "papr"), ("papr", "paper")),
    "no screen": (good("--camera", "demo", "--display", "window"), ("window", "--display none")),
    "unknown display": (good("--camera", "demo", "--display", "windw"), ("windw", "did you mean")),
    "unwritable video": (good("--camera", "demo", "--display", "file:/proc/x/out.mkv"), ("/proc/x",)),
    "unwritable trace": (good("--camera", "demo", "--display", "none", "--trace", "/proc/x/t.jsonl"), ("/proc/x/t.jsonl",)),
    "everything": (lambda root: [*EVERYTHING], ("nowhere", "nofile.mp4", "windw", "/proc/x/t.jsonl")),
    "session name": (good("--session", "a/b"), ("a/b",)),
    "unknown session": (lambda root: ["monitor", "--session", "nobody", "--once"], ("nobody",)),
    "ctl to unknown session": (lambda root: ["ctl", "--session", "nobody", "stop"], ("nobody",)),
    "unknown command": (lambda root: ["monitr"], ("monitr", "Did you mean 'monitor'")),
    "unknown option": (lambda root: ["up", "--durtion", "3"], ("--durtion", "--duration")),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_refused_with_its_remedy(tmp_path: Path, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make, named = CASES[case]
    world = World(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "LFPIPE_SESSION"):
        monkeypatch.delenv(name, raising=False)
    for name, value in world.env.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(world.root)
    result = CliRunner().invoke(cli, [str(word) for word in make(world.root)])
    refusal = result.exception
    assert isinstance(refusal, UserError) or result.exit_code == 2, (result.output, refusal)
    message = f"{result.output}{refusal}"
    assert all(word in message for word in named), message
    assert "remedy: " in message or not isinstance(refusal, UserError)
    assert not world.left(), "no process, no run directory"


@pytest.mark.native("/dev/shm")
def test_a_small_dev_shm_ends_the_command_and_not_the_machine(world: World, scene: Path) -> None:
    script = 'mount -t tmpfs -o size=1m tmpfs /dev/shm || exit 77; exec "$@"'
    command = [*("unshare", "-m", "sh", "-c", script, "-"), world.python, "-m", "lfpipe", "up", str(scene), "--camera", "demo"]
    done = subprocess.run([*command, "--display", "none"], capture_output=True, text=True, env=world.env, cwd=world.root)
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip(f"mounting is not allowed here: {done.stderr.strip()}")
    assert done.returncode == 2 and "/dev/shm has" in done.stderr and "--shm-size" in done.stderr, done.stderr
    assert "Traceback" not in done.stderr and not world.left()


def test_help_completion_and_version_work_without_anything(world: World) -> None:
    for args in (["--help"], ["up", "--help"], ["ctl", "--help"], ["completion", "bash"], ["--version"]):
        done = world.run(*args)
        assert done.returncode == 0 and done.stdout and not done.stderr


def test_config_is_written_shown_and_checked(world: World) -> None:
    path = world.root / "mine.toml"
    assert world.run("config", "init", path).returncode == 0
    assert world.run("config", "check", path).returncode == 0
    assert world.run("config", "init", path).returncode == 2, "nothing is lost"
    assert "mean_k = 7" in world.run("config", "show", "--config", path, "--set", "track.mean_k=7").stdout
    path.write_text(path.read_text().replace('engine = "', 'engin = "'))
    done = world.run("config", "check", path)
    assert done.returncode == 2 and "did you mean 'track.engine'" in done.stderr
