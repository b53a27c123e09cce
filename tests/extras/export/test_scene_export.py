"""Exports of a scene, read by independent programs: FFmpeg's libraries through PyAV, Pillow."""

import shutil
import subprocess
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image, ImageSequence

from lfpipe.cli.scene import scene as command
from lfpipe.config import Scene
from lfpipe.extras.export.pictures import (
    quilt_name,
    write_clip,
)
from lfpipe.scene.packing import pack_scene
from tests.scene import made


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("cache"))


def decoded(path: Path) -> list[np.ndarray]:
    """The frames of an H.264 video, RGB, as FFmpeg decodes them by what the file says of its
    colours. Its index comes first.
    """
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def frames(image: Image.Image) -> list[np.ndarray]:
    """The pictures of a file, RGB, as Pillow reads them."""
    return [np.asarray(picture.convert("RGB")) for picture in ImageSequence.Iterator(image)]


def export(scene: Path, out: Path, form: str, *words: object, cache: str) -> Path:
    options = ["--set", f"scene.cache_dir={cache}"]
    done = CliRunner().invoke(
        command, ["export", form, str(scene), "-o", str(out), *map(str, words), *options]
    )
    assert done.exit_code == 0, done.output + repr(done.exception)
    return Path(done.stdout.split()[0])  # progress of a slow machine is on stderr


def test_a_quilt_runs_from_the_bottom_left_and_reads_back(
    scene: Path, cache: str, tmp_path: Path
) -> None:
    path = export(scene, tmp_path / "boxes.png", "quilt", "--tiles", "3x1", cache=cache)
    row = np.asarray(cv2.imread(str(path)))
    assert path.name == "boxes_qs3x1a1.33.png" and row.shape == (48, 192, 3)
    assert [row[0, 64 * k, 1] for k in range(3)] == [5, 13, 21]  # green tells the column
    path = export(scene, tmp_path / "tall.png", "quilt", "--tiles", "1x3", cache=cache)
    column = np.asarray(cv2.imread(str(path)))
    # the leftmost view at the bottom
    assert [column[48 * k, 0, 1] for k in range(3)] == [21, 13, 5]
    again = pack_scene(path, Scene(cache_dir=cache))
    assert (again.rows, again.cols) == (1, 3) and again.views[0, 0, :, 1, 0, 0].tolist() == [
        5,
        13,
        21,
    ]
    assert quilt_name(Path("b_qs5x9a0.75.png"), 5, 9, 1) == Path("b_qs5x9a0.75.png")


@pytest.fixture(scope="module")
def textured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A row of three views that move by 3 px from one to the next."""
    return made.write_grid(tmp_path_factory.mktemp("textured") / "row", made.wall(1, 3, 96, 128, 3))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".jps", ".mpo"])
def test_every_pair_is_read_back_and_by_pillow(
    textured: Path, cache: str, tmp_path: Path, suffix: str
) -> None:
    how = ("pair", "--apart", 2, "--set", "render.zero_plane_px=0")
    path = export(textured, tmp_path / f"boxes{suffix}", *how, cache=cache)
    assert path.stem == ("boxes_sbs" if suffix in (".png", ".jpg") else "boxes")
    files = [str(textured / f"view_00_0{col}.png") for col in (0, 2)]
    eyes = [np.asarray(cv2.imread(name))[..., ::-1].astype(int) for name in files]
    with Image.open(path) as image:
        halves = frames(image)
        if suffix != ".mpo":
            halves = [halves[0][:, :128], halves[0][:, 128:]][:: -1 if suffix == ".jps" else 1]
    again = pack_scene(path, Scene(cache_dir=cache))
    assert (again.rows, again.cols) == (1, 2)
    for k in (0, 1):
        for seen in (halves[k], np.moveaxis(again.views[0, 0, k], 0, 2)):
            assert np.abs(seen.astype(int) - eyes[k]).mean() < 3
    # the name is kept
    assert export(textured, path, *how, "--overwrite", cache=cache) == path


def test_a_pair_in_motion_and_a_sweep_are_videos(scene: Path, cache: str, tmp_path: Path) -> None:
    path = export(scene, tmp_path / "boxes.mp4", "pair", "--apart", 1, "--seconds", 1, cache=cache)
    pairs = decoded(path)
    assert path.name == "boxes_LR.mp4" and len(pairs) == 30 and pairs[0].shape == (48, 128, 3)
    assert all(
        float(frame[5, 100, 1]) - float(frame[5, 5, 1]) == pytest.approx(8, abs=4)
        for frame in pairs
    ), "left eye left"
    if shutil.which("ffprobe"):
        entries = [
            "-show_entries",
            "stream=codec_name,pix_fmt,width,height,nb_frames",
            "-of",
            "csv=p=0",
        ]
        answer = subprocess.check_output(["ffprobe", "-v", "error", *entries, path], text=True)
        assert answer.strip() == "h264,128,48,yuv420p,30"
    sweep = decoded(export(scene, tmp_path / "sweep.mp4", "sweep", "--seconds", 1, cache=cache))
    greens = [float(frame[..., 1].mean()) for frame in sweep]
    assert len(greens) == 30 and sweep[0].shape == (48, 64, 3)
    assert greens[0] == pytest.approx(5, abs=2.5) and greens[15] == max(greens) == pytest.approx(
        21, abs=2.5
    )


@pytest.mark.parametrize("size", [(64, 48), (61, 37)])
def test_colours_survive_h264(tmp_path: Path, size: tuple[int, int]) -> None:
    width, height = size
    ramp = np.linspace(0, 255, width)[None, :, None] * np.array([1.0, 0.6, 0.3]) + np.zeros(
        (height, 1, 1)
    )
    pictures = [np.roll(ramp.astype(np.uint8), k, axis=2) for k in range(3)]
    write_clip(tmp_path / "x.mp4", (pictures[k // 10] for k in range(30)), 25.0)
    frames = decoded(tmp_path / "x.mp4")
    assert len(frames) == 30
    for k, frame in enumerate(frames):
        error = frame[:height, :width, ::-1].astype(float) - pictures[k // 10]
        assert abs(error.mean()) < 3 and 10 * np.log10(255**2 / (error**2).mean()) > 30


def test_a_wiggle_loops_for_ever_as_gif(scene: Path, cache: str, tmp_path: Path) -> None:
    with Image.open(
        export(scene, tmp_path / "wiggle.gif", "wiggle", "--apart", 2, cache=cache)
    ) as image:
        shades = [picture[5, 5, 1] for picture in frames(image)]
        assert len(shades) >= 2 and image.info["loop"] == 0
    assert min(shades) == pytest.approx(5, abs=1) and max(shades) == pytest.approx(21, abs=1)
    assert (
        len(decoded(export(scene, tmp_path / "wiggle.mp4", "wiggle", "--apart", 2, cache=cache)))
        == 24
    )
