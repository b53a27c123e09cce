"""The configuration: every error named at once, every key explained, presets whole."""

import tomllib
from pathlib import Path

import pytest

from lfpipe import config
from lfpipe.config import Config
from lfpipe.config.user_files import commented
from lfpipe.errors import UserError
from tools.make_reference import DOCS, PAGES


@pytest.fixture(autouse=True)
def user_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    return tmp_path / "user" / "lfpipe"


def test_the_file_at_the_top_and_the_pages_of_keys_and_commands_are_current() -> None:
    assert (Path(__file__).parents[2] / "config.toml").read_text() == commented(), "run: lfpipe config show > config.toml"
    for name, text in PAGES.items():
        assert (DOCS / name).read_text() == text(), "run: python tools/make_reference.py"


def test_the_text_of_any_configuration_reads_back_as_itself() -> None:
    for tree in (Config(), config.load("paper")):
        assert config.from_dict(tomllib.loads(commented(tree))) == tree
        assert config.trusted(config.to_dict(tree)) == tree


def test_every_error_of_every_layer_is_named_at_once(user_folder: Path, tmp_path: Path) -> None:
    user_folder.mkdir(parents=True)
    (user_folder / "config.toml").write_text("[camera]\nrate_hz = -3\n[trakc]\nx = 1\n")
    (tmp_path / "mine.toml").write_text("[render\n")
    sets = ["camera.widht=3", "render.method=neerest", "render.method:warp", "render.alpha_px=abc", "track.mean_k=2.5", "=3"]
    sets += ["render.swap_eyes=1", "screen.width_mm=nan", "camera.fov_deg=[[", "render={}", "screen.distance_mm=1" + "0" * 30]
    with pytest.raises(UserError) as error:
        config.load(tmp_path / "mine.toml", sets)
    for part in (
        "config.toml: camera.rate_hz: -3 is out of range: 0.1 to 1000 Hz",
        "config.toml: trakc: unknown key, did you mean 'track'?",
        "mine.toml: not valid TOML",
        "camera.widht: unknown key, did you mean 'camera.width_px'?",
        "render.method: 'neerest' is not one of",
        "did you mean 'nearest'?",
        "'render.method:warp' is not KEY=VALUE",
        "'=3' is not KEY=VALUE",
        "render.alpha_px: 'abc' is not",
        "track.mean_k: 2.5 is not a whole number",
        "render.swap_eyes: 1 is not true or false",
        "screen.width_mm: nan is out of range",
        "camera.fov_deg: '[[' is not a number",
        "render: a section",
        "screen.distance_mm: inf is out of range",
        "remedy:",
    ):
        assert part in str(error.value), error.value


def test_layers_win_in_order(user_folder: Path, tmp_path: Path) -> None:
    user_folder.mkdir(parents=True)
    (user_folder / "config.toml").write_text("[camera]\nrate_hz = 15\nwidth_px = 320\n[render]\nmethod = 'blend'\n")
    (tmp_path / "mine.toml").write_text("[camera]\nrate_hz = 25\n")
    loaded = config.load(tmp_path / "mine.toml", ["render.method=warp", "camera.fov_deg=175"])
    assert (loaded.camera.rate_hz, loaded.camera.width_px, loaded.render.method) == (25.0, 320, "warp")
    assert loaded.camera.fov_deg == 175.0, "a range holds its ends"


def test_the_paper_is_a_whole_configuration() -> None:
    paper = config.load("paper")
    assert (paper.track.engine, paper.track.filter, paper.track.mean_k) == ("mediapipe", "mean", 5)
    assert (paper.render.clock, paper.render.method, paper.render.anaglyph) == ("camera", "nearest", "colour")


def test_a_running_session_takes_live_keys_only() -> None:
    assert config.updated(Config(), {"render.alpha_px": 3}, live_only=True).render.alpha_px == 3.0
    assert config.updated(Config(), {"camera.width_px": 320}).camera.width_px == 320, "one that is still to begin takes all"
    with pytest.raises(UserError, match=r"camera\.width_px.*fixed while a session runs"):
        config.updated(Config(), {"render.alpha_px": 3, "camera.width_px": 320}, live_only=True)
