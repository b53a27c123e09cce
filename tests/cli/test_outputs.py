"""What commands write: refused, they leave every file of a person as it was."""

import os
import shutil
from pathlib import Path

import cv2
import pytest
from click.testing import CliRunner
from pytest import param

from lfpipe.cli import cli
from lfpipe.errors import UserError
from tests.support.extras import with_extras
from tests.support.world import World, write_scene


def _content(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.is_symlink()
    }


@pytest.fixture(scope="module")
def owned(tmp_path_factory: pytest.TempPathFactory, clip: Path) -> Path:
    """A folder of a person's files."""
    folder = tmp_path_factory.mktemp("owned")
    write_scene(folder / "views")
    shutil.copy(clip, folder / "me.avi")
    (folder / "notes.txt").write_text("mine\n" * 1000)
    os.mkfifo(folder / "fifo.mkv")
    (folder / "link.mkv").symlink_to("me.avi")
    (folder / "walk").mkdir()
    (folder / "walk" / "manifest.json").write_text('{"format": "lfpipe-sequence"}')  # as it begins
    (folder / "plan.toml").write_text('sequences = ["walk"]\nsubjects = ["replay"]\n')
    return folder


@pytest.mark.parametrize(
    ("args", "named"),
    [
        ("up /nowhere --trace notes.txt", "notes.txt"),
        ("up /nowhere --camera file:me.avi --trace me.avi --overwrite", "me.avi"),
        ("up views --camera demo --display none --trace notes.txt", "notes.txt"),
        (
            "up views --camera demo --display none --trace views/view_01_01.png --overwrite",
            "view_01_01.png",
        ),
        ("up views --camera file:me.avi --display file:me.avi --overwrite", "me.avi"),
        ("up views --camera file:me.avi --display file:link.mkv --overwrite", "link.mkv"),
        ("up views --camera demo --display file:fifo.mkv --overwrite", "fifo.mkv"),
        ("up views --camera demo --display file:new.mkv --trace new.mkv", "new.mkv"),
        ("scene view views --row 0 --col 0 -o views/view_01_01.png", "view_01_01.png"),
        ("scene view views --row 0 --col 0 -o notes.txt", "notes.txt"),
        ("scene view views --row 0 --col 0 -o me.png", "me.png"),
        param("scene export pair views -o me.avi", "me_sbs.avi", marks=with_extras),
        param(
            "scene export pair views -o views/view_00_00.png",
            "view_00_00_sbs.png",
            marks=with_extras,
        ),
        ("replay walk --junit walk/manifest.json", "manifest.json"),
        ("replay views --expect walk --junit walk/manifest.json", "manifest.json"),
        ("replay views --out walk --junit walk/j.xml", "j.xml"),
        param("sweep plan.toml --junit walk/manifest.json", "manifest.json", marks=with_extras),
        ("replay walk --out views/out --junit walk/truth.csv", "truth.csv"),
        ("replay views --junit notes.txt", "notes.txt"),
        ("replay walk --out walk/out", "walk/out"),
        ("replay views --scene views --expect views/ref --update", "views/ref"),
        ("replay walk --expect nothing", "nothing"),
        ("doctor --report notes.txt", "notes.txt"),
    ],
)
def test_outputs_keep_the_files_of_a_person(
    owned: Path, monkeypatch: pytest.MonkeyPatch, args: str, named: str
) -> None:
    monkeypatch.chdir(owned)
    monkeypatch.setenv("LFPIPE_KIOSK_CODE", "leave2026")
    (owned / "me.png").write_bytes(min((owned / "views").iterdir()).read_bytes())
    before = _content(owned)
    error = CliRunner().invoke(cli, args.split()).exception
    assert isinstance(error, UserError) and named in error.message, error
    assert _content(owned) == before


def test_up_from_file_to_file_plays_once(world: World, scene: Path, clip: Path) -> None:
    done = world.done(
        "up",
        scene,
        "--camera",
        f"file:{clip}",
        "--display",
        "file:out.mkv",
        "--session",
        world.name,
    )
    assert "out.mkv" in done.stdout, done.stderr
    frames = cv2.VideoCapture(str(world.root / "out.mkv")).get(cv2.CAP_PROP_FRAME_COUNT)
    assert 60 <= frames <= 240, "60 frames at 30 Hz, shown at 60 Hz"


def test_up_demo_without_a_screen_leaves_a_video_and_a_picture(world: World) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        world.env.pop(name, None)
    world.done("up", "--demo", "--duration", "1.5")
    (video,) = Path(world.root, "lfpipe-demo").glob("demo.m*")
    film = cv2.VideoCapture(str(video))
    assert film.read()[0] and film.get(cv2.CAP_PROP_FRAME_COUNT) >= 10
    picture = cv2.imread(str(video.with_suffix(".png")))
    assert picture is not None and picture.std() > 20, "a picture of something"
    assert not world.left()
