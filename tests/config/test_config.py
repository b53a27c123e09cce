"""The configuration: every error named at once, every key explained, presets whole."""

import tomllib
from pathlib import Path

import pytest

from lfpipe import config
from lfpipe.config import Config
from lfpipe.config.user_files import commented
from lfpipe.errors import UserError


@pytest.fixture(autouse=True)
def no_user_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "none"))


def test_the_file_at_the_top_is_what_the_tree_says() -> None:
    assert (Path(__file__).parents[2] / "config.toml").read_text() == commented(), "run: lfpipe config show > config.toml"


def test_the_text_of_any_configuration_reads_back_as_itself() -> None:
    for tree in (Config(), config.load("paper")):
        assert config.from_dict(tomllib.loads(commented(tree))) == tree
        assert config.trusted(config.to_dict(tree)) == tree


def test_every_error_is_named_at_once() -> None:
    sets = ["camera.widht=3", "render.method=neerest", "camera.rate_hz=-4", "render.alpha_px=abc", "track.mean_k=2.5"]
    sets += ["render.method:warp", "=3", "rendr.x=1", "render.swap_eyes=1", "screen.width_mm=nan", "camera.fov_deg=175.5"]
    with pytest.raises(UserError) as error:
        config.load(None, sets)
    text = str(error.value)
    for part in (
        "camera.widht: unknown key, did you mean 'camera.width_px'?",
        "render.method: 'neerest' is not one of",
        "did you mean 'nearest'?",
        "camera.rate_hz: -4 is out of range: 0.1 to 1000 Hz",
        "render.alpha_px: 'abc' is not",
        "track.mean_k: 2.5 is not a whole number",
        "'render.method:warp' is not KEY=VALUE",
        "'=3' is not KEY=VALUE",
        "rendr: unknown key, did you mean 'render'?",
        "render.swap_eyes: 1 is not true or false",
        "screen.width_mm: nan is out of range",
        "camera.fov_deg: 175.5 is out of range: 5 to 175 deg",
        "remedy:",
    ):
        assert part in text, text


def test_layers_win_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    (tmp_path / "lfpipe").mkdir()
    (tmp_path / "lfpipe" / "config.toml").write_text("[camera]\nrate_hz = 15\nwidth_px = 320\n[render]\nmethod = 'blend'\n")
    given_file = tmp_path / "mine.toml"
    given_file.write_text("[camera]\nrate_hz = 25\n")
    loaded = config.load(given_file, ["render.method=warp", "camera.fov_deg=175"])
    assert (loaded.camera.rate_hz, loaded.camera.width_px, loaded.render.method) == (25.0, 320, "warp")
    assert loaded.camera.fov_deg == 175.0, "a range holds its ends"


def test_the_paper_is_a_whole_configuration() -> None:
    paper = config.load("paper")
    assert (paper.track.engine, paper.track.filter, paper.track.mean_k) == ("mediapipe", "mean", 5)
    assert (paper.render.clock, paper.render.method, paper.render.anaglyph) == ("camera", "nearest", "colour")


def test_files_that_are_none(tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("[camera\n")
    for path, part in ((broken, "not valid TOML"), (tmp_path, "is a directory"), ("papr", r"No such file(.|\n)*preset: paper")):
        with pytest.raises(UserError, match=part):
            config.load(path)
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="not UTF-8: byte 0xff at 0"):
        config.load(broken)


def test_a_running_session_takes_live_keys_only() -> None:
    assert config.updated(Config(), {"render.alpha_px": 3}, live_only=True).render.alpha_px == 3.0
    assert config.updated(Config(), {"camera.width_px": 320}).camera.width_px == 320, "one that is still to begin takes all"
    with pytest.raises(UserError, match=r"camera\.width_px.*fixed while a session runs"):
        config.updated(Config(), {"render.alpha_px": 3, "camera.width_px": 320}, live_only=True)


def test_the_pages_of_keys_and_commands_are_current() -> None:
    from tools.make_reference import DOCS, PAGES

    for name, text in PAGES.items():
        assert (DOCS / name).read_text() == text(), "run: python tools/make_reference.py"
