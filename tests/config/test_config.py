"""The configuration: every error named at once, every key explained, presets whole."""

import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.config import Config, load
from lfpipe.config.user_files import commented
from lfpipe.errors import UserError


@pytest.fixture(autouse=True)
def no_user_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "none"))


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("render.method:warp", "did you mean render.method=warp?"),
        ("render.method warp", "did you mean render.method=warp?"),
        ("render.methd:warp", "did you mean render.method=warp?"),
        ("render.alpha_px", "the value is missing; for example render.alpha_px=auto"),
        ("nonsense", "'nonsense' is not KEY=VALUE"),
        ("render.display_ms=30", "--set render.loop_ms=30"),
    ],
)
def test_a_slip_inside_set_is_answered_with_what_was_meant(typed: str, said: str) -> None:
    with pytest.raises(UserError, match=re.escape(said)):
        load(None, [typed])


def test_the_file_at_the_top_is_what_the_tree_says() -> None:
    assert (Path(__file__).parents[2] / "config.toml").read_text() == commented(), "run: lfpipe config show > config.toml"


def test_the_text_of_any_configuration_reads_back_as_itself() -> None:
    for tree in (Config(), config.load("paper")):
        assert config.from_dict(tomllib.loads(commented(tree))) == tree
        assert config.trusted(config.to_dict(tree)) == tree


def test_every_error_is_named_at_once() -> None:
    sets = ["camera.widht=3", "render.method=neerest", "camera.rate_hz=-4", "render.alpha_px=abc", "track.mean_k=2.5"]
    with pytest.raises(UserError) as error:
        config.load(None, [*sets, "rendr.x=1", "render.swap_eyes=1", "screen.width_mm=nan", "camera.fov_deg=175.5"])
    text = str(error.value)
    for part in (
        "camera.widht: unknown key, did you mean 'camera.width_px'?",
        "render.method: 'neerest' is not one of",
        "did you mean 'nearest'?",
        "camera.rate_hz: -4 is out of range: 0.1 to 1000 Hz",
        "render.alpha_px: 'abc' is not",
        "track.mean_k: 2.5 is not a whole number",
        "rendr: unknown key, did you mean 'render'?",
        "render.swap_eyes: 1 is not true or false",
        "screen.width_mm: nan is out of range",
        "camera.fov_deg: 175.5 is out of range: 5 to 175 deg",
        "remedy:",
    ):
        assert part in text, text


def test_a_former_key_is_answered_with_the_one_that_took_its_place(tmp_path: Path) -> None:
    old = tmp_path / "old.toml"
    old.write_text("[render]\ndisplay_ms = 30\n")
    with pytest.raises(UserError, match=r"render\.display_ms: write render\.loop_ms instead.*calibrate --latency"):
        config.load(old)


def test_a_range_holds_its_ends() -> None:
    for value in (5, 175):
        assert config.load(None, [f"camera.fov_deg={value}"]).camera.fov_deg == float(value)


def test_layers_win_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    (tmp_path / "lfpipe").mkdir()
    (tmp_path / "lfpipe" / "config.toml").write_text("[camera]\nrate_hz = 15\nwidth_px = 320\n[render]\nmethod = 'blend'\n")
    given_file = tmp_path / "mine.toml"
    given_file.write_text("[camera]\nrate_hz = 25\n")
    loaded = config.load(given_file, ["render.method=warp"])
    assert (loaded.camera.rate_hz, loaded.camera.width_px, loaded.render.method) == (25.0, 320, "warp")


def test_the_paper_is_a_whole_configuration() -> None:
    paper = config.load("paper")
    assert (paper.track.engine, paper.track.filter, paper.track.mean_k) == ("mediapipe", "mean", 5)
    assert (paper.render.clock, paper.render.method, paper.render.anaglyph) == ("camera", "nearest", "colour")


@pytest.mark.parametrize("text", ["camera.rate_hz", "=3", "", "render"])
def test_what_is_no_key_and_value_is_said(text: str) -> None:
    with pytest.raises(UserError, match="KEY=VALUE"):
        config.parse_set(text)


def test_files_that_are_none(tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("[camera\n")
    for path, part in ((broken, "not valid TOML"), (tmp_path, "is a directory"), ("papr", r"No such file(.|\n)*preset: paper")):
        with pytest.raises(UserError, match=part):
            config.load(path)
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="not UTF-8: byte 0xff at 0"):
        config.load(broken)


@given(key=st.text(max_size=20), value=st.none() | st.integers() | st.floats() | st.text(max_size=5) | st.lists(st.integers()))
def test_any_set_is_taken_whole_or_refused(key: str, value: object) -> None:
    before = Config()
    try:
        after = config.updated(before, {key: value})
    except UserError:
        return
    assert after == before or key in config.options()


def test_a_running_session_takes_live_keys_only() -> None:
    assert config.updated(Config(), {"render.alpha_px": 3}, live_only=True).render.alpha_px == 3.0
    assert config.updated(Config(), {"camera.width_px": 320}).camera.width_px == 320, "one that is still to begin takes all"
    with pytest.raises(UserError, match=r"camera\.width_px.*fixed while a session runs"):
        config.updated(Config(), {"render.alpha_px": 3, "camera.width_px": 320}, live_only=True)


def test_the_pages_of_keys_and_commands_are_current() -> None:
    from tools.make_reference import DOCS, PAGES

    for name, text in PAGES.items():
        assert (DOCS / name).read_text() == text(), "run: python tools/make_reference.py"
