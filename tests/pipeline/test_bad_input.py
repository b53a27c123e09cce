"""Errors are reported before any process starts: the thing, the value, the remedy, exit code 2, no traceback."""

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from lfpipe.cli import cli
from lfpipe.errors import UserError
from tests.world import World, write_scene


def good(*args: str | Path) -> Callable[[Path], list[str | Path]]:
    return lambda root: ["up", write_scene(root / "good"), *args]


CASES: dict[str, tuple[Callable[[Path], list[str | Path]], tuple[str, ...]]] = {
    "no scene": (lambda root: ["up"], ("SCENE", "--demo")),
    "camera gone": (good("--camera", "camera:/dev/video97", "--display", "none"), ("97",)),
    "all keys at once": (good("--set", "track.mean_k=0", "--set", "render.alpa_px=3"), ("track.mean_k", "'render.alpha_px'")),
    "unknown preset": (good("--config", "papr"), ("papr", "paper")),
    "no screen": (good("--camera", "demo", "--display", "window"), ("window", "--display none")),
    "unknown display": (good("--display", "windw"), ("windw",)),
    "camera file gone": (good("--camera", "file:nofile.mp4", "--display", "none"), ("nofile.mp4",)),
    "unknown session": (lambda root: ["monitor", "--session", "nobody", "--once"], ("nobody",)),
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
