"""The configuration: every error named at once, every key explained, presets whole; and from files,
the command line and messages any content is accepted completely or refused by name.
"""

import sys
import tomllib
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.cli import cli
from lfpipe.config import Config, converter
from lfpipe.config.check import commented, flat
from lfpipe.errors import UserError
from tests.support.examples import examples
from tests.support.hostile_files import NO_FILES, TOML_TEXTS, VALUES, ended
from tests.support.refusal import refusal


@pytest.fixture(autouse=True)
def user_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    return tmp_path / "user" / "lfpipe"


def test_the_text_of_any_configuration_reads_back_as_itself() -> None:
    for tree in (Config(), config.load("paper")):
        assert read(tomllib.loads(commented(tree))) == tree
        assert converter().structure(converter().unstructure(tree), Config) == tree


def test_every_error_of_every_layer_is_named_at_once(user_folder: Path, tmp_path: Path) -> None:
    user_folder.mkdir(parents=True)
    (user_folder / "config.toml").write_text("[camera]\nrate_hz = -3\n[trakc]\nx = 1\n")
    (tmp_path / "mine.toml").write_text("[render\n")
    sets = [
        "camera.widht=3",
        "render.method=neerest",
        "render.method:warp",
        "render.alpha_px=abc",
        "track.mean_k=2.5",
        "=3",
    ]
    sets += [
        "render.swap_eyes=1",
        "screen.width_mm=nan",
        "camera.fov_deg=[[",
        "render={}",
        "screen.distance_mm=1" + "0" * 30,
    ]
    said = str(refusal(config.load, tmp_path / "mine.toml", sets))
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
        assert part in said, said
    assert "config init FILE" in refusal(config.load).remedy, (
        "`config show` fails as long as the user's own file is wrong"
    )


def test_layers_win_in_order(user_folder: Path, tmp_path: Path) -> None:
    user_folder.mkdir(parents=True)
    (user_folder / "config.toml").write_text(
        "[camera]\nrate_hz = 15\nwidth_px = 320\n[render]\nmethod = 'blend'\n"
    )
    (tmp_path / "mine.toml").write_text("[camera]\nrate_hz = 25\n")
    loaded = config.load(tmp_path / "mine.toml", ["render.method=warp", "camera.fov_deg=175"])
    assert (loaded.camera.rate_hz, loaded.camera.width_px, loaded.render.method) == (
        25.0,
        320,
        "warp",
    )
    assert loaded.camera.fov_deg == 175.0, "a range holds its ends"


def test_the_paper_is_a_whole_configuration() -> None:
    paper = config.load("paper")
    assert (paper.track.engine, paper.track.filter, paper.track.mean_k) == ("mediapipe", "mean", 5)
    assert (paper.render.clock, paper.render.method, paper.render.anaglyph) == (
        "camera",
        "nearest",
        "colour",
    )


def test_a_running_session_takes_live_keys_only() -> None:
    assert config.updated(Config(), {"render.alpha_px": 3}, live_only=True).render.alpha_px == 3.0
    assert config.updated(Config(), {"camera.width_px": 320}).camera.width_px == 320, (
        "one that is still to begin takes all"
    )
    with pytest.raises(UserError, match=r"camera\.width_px.*fixed while a session runs"):
        config.updated(Config(), {"render.alpha_px": 3, "camera.width_px": 320}, live_only=True)


KEYS = sorted(config.options())
SECTIONS = sorted({key.partition(".")[0] for key in KEYS})
NAMES = (
    st.sampled_from([*KEYS, *SECTIONS])
    | st.text(max_size=20)
    | st.sampled_from(KEYS).map(lambda key: key + ".x")
)
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=9)
    | st.binary(max_size=9)
    | st.datetimes()
)
SHAPES = st.recursive(
    st.sampled_from(VALUES) | LEAVES,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(NAMES | st.integers() | st.none(), inner, max_size=4)
    ),
    max_leaves=20,
)


def read(tree: dict[str, Any]) -> Config:
    """The configuration that a table of sections gives."""
    return config.updated(Config(), {str(key): value for key, value in flat(tree)})


def usable(made: Config) -> None:
    """Accepted settings can be sent to a stage, stored and printed, and come back unchanged."""
    assert (
        converter().structure(msgpack.unpackb(msgpack.packb(converter().unstructure(made))), Config)
        == made
    )
    assert read(tomllib.loads(commented(made).encode().decode())) == made


@examples(60)
@example(sets={"render": {}}, live=True)
@example(sets={"render": {"alpha_px": 3}}, live=True)
@example(sets={"": 1}, live=True)
@example(sets={"screen.monitor": 10**400}, live=False)
@example(sets={"screen.monitor": 2**64}, live=False)
@example(sets={"camera.source": "\udcff"}, live=False)
@example(sets={"render.alpha_px": 10**400}, live=True)
@example(sets={"camera.source": '\U0001f600 a"b\\c 日本'}, live=False)
@given(sets=st.dictionaries(NAMES | st.integers(), SHAPES, max_size=4), live=st.booleans())
def test_a_change_is_taken_whole_or_refused(sets: dict[str, Any], live: bool) -> None:
    before = Config()
    try:
        after = config.updated(before, sets, live_only=live)
    except UserError as error:
        assert len(str(error)) <= 2000
        return
    assert set(sets) <= set(KEYS)
    usable(after)


@pytest.mark.parametrize("text", TOML_TEXTS, ids=range(len(TOML_TEXTS)))
def test_any_text_is_taken_or_refused_by_the_name_of_its_layer(text: str, tmp_path: Path) -> None:
    for key in (*KEYS, "render", "x", "a.b.c", "", "\udcff", "x" * 5000):
        try:
            name, value = config.parse_set(f"{key}={text}")
            msgpack.packb({name: value})
            usable(config.load(None, [f"{key}={text}"]))
        except UserError as error:
            assert len(str(error)) <= 2000
    path = tmp_path / "mine.toml"
    for head in (
        "[render]\nalpha_px = ",
        "[camera]\nsource = ",
        "render = ",
        "x = ",
        "[[render]]\na = ",
        "",
    ):
        path.write_text(head + text, "utf-8", "surrogatepass")
        try:
            usable(config.load(path))
        except UserError as error:
            assert "mine.toml" in error.message and len(str(error)) <= 2000, error


@pytest.mark.parametrize("kind", sorted(set(NO_FILES) - {"empty"}))
def test_what_is_no_file_is_refused_at_once(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lfpipe").mkdir()
    for path, name in (
        (tmp_path / "mine.toml", tmp_path / "mine.toml"),
        (tmp_path / "lfpipe" / "config.toml", None),
    ):
        NO_FILES[kind](path)
        monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path if name is None else tmp_path / "none"))
        assert path.name in str(refusal(config.load, name))
    for wrong in (
        "papr",
        "a\0b",
        "x" * 300,
        "x" * 5000,
        "\udcff",
        "/dev/null",
        "/proc/self/mem",
        "/dev/stdin/x",
    ):
        assert "--config" in str(refusal(config.load, wrong))


def test_what_is_written_is_never_half(tmp_path: Path) -> None:
    for there in ("/dev/full", str(tmp_path)):
        said = refusal(cli.main, ["config", "init", there], standalone_mode=False)
        assert said.message == f"{there} exists"
    new = tmp_path / "new" / "c.toml"
    for place, expected in (("/proc/x/c.toml", 2), (tmp_path / ("x" * 300), 2), (new, 0)):
        code, out, err, _ = ended([sys.executable, "-m", "lfpipe", "config", "init", str(place)])
        assert code == expected and err.startswith("error: " if expected else ""), err
    assert out.strip().endswith("c.toml") and config.load(new) == Config()
