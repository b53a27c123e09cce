"""The pack: what is in it, that it is made whole or not at all, and that two may make it at once."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import attrs
import numpy as np
import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import cache, layouts, packing
from lfpipe.scene.disparity import estimate_disparity, mismatch, quantised, scale_for
from lfpipe.scene.grey_views import grey_views
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.optical_flow import SMALLEST_PX
from lfpipe.scene.pack import DamagedPackError, PlaneFile, open_pack
from lfpipe.scene.packing import pack_scene
from tests.hostile_files import NO_FILES
from tests.scene import made
from tests.scene.test_layouts import old_hci


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    grid = made.views(3, 3)
    made.write_grid(tmp_path / "scene", grid, "input_Cam{n:03d}.png")
    made.write_pfm(tmp_path / "scene" / "gt_disp_lowres.pfm", made.middle_disparity())
    return tmp_path / "scene"


def left_over(scene: config.Scene) -> list[str]:
    return [path.name for path in (Path(scene.cache_dir) / "scenes").iterdir() if path.name.startswith(".")]


def test_a_pack_holds_the_views_planar_and_the_disparity(folder: Path, scene_config: config.Scene) -> None:
    seen: list[tuple[str, int, int]] = []
    field = pack_scene(folder, scene_config, lambda *report: seen.append(report))
    grid = made.views(3, 3)
    assert np.array_equal(field.views[0].transpose(0, 1, 3, 4, 2), grid)
    assert not field.views.flags.writeable
    assert field.disparity is not None and field.disparity.shape == (1, 3, 3, 48, 64)
    assert (field.disparity_min_px, field.disparity_max_px, field.disparity_source) == (-1.0, 2.0, "truth")
    found = field.disparity[0, 1, 1] * np.float32(field.disparity_scale_px)
    wrong = np.abs(found - made.middle_disparity()[::2, ::2])
    assert np.median(wrong) < 0.15
    assert np.mean(wrong > 0.7) < 0.15  # the rims of the shapes
    assert field.method in ("warp", "warp2") and field.manifest["scores"]["warp"] > field.manifest["scores"]["nearest"]
    assert [report for report in seen if report[0] == "views"][-1] == ("views", 9, 9)
    assert left_over(scene_config) == []


def test_the_second_time_nothing_is_read(folder: Path, scene_config: config.Scene) -> None:
    assert cache.find_pack(folder, scene_config) is None
    pack_scene(folder, scene_config)
    found = cache.find_pack(folder, scene_config)
    assert found is not None
    seen: list[str] = []
    assert pack_scene(folder, scene_config, lambda what, *_: seen.append(what)).rows == 3
    assert seen == []
    assert open_pack(found).name == "scene"


def test_touched_files_are_recognised_by_content_and_changed_ones_packed_anew(folder: Path, scene_config: config.Scene) -> None:
    first = pack_scene(folder, scene_config)
    os.utime(folder / "input_Cam004.png")
    assert cache.find_pack(folder, scene_config) is None
    seen: list[str] = []
    again = pack_scene(folder, scene_config, lambda what, *_: seen.append(what))
    assert seen == [] and again.manifest["key"] == first.manifest["key"]
    made.write(folder / "input_Cam004.png", made.views(3, 3)[0, 0])
    assert pack_scene(folder, scene_config).manifest["key"] != first.manifest["key"]


def test_the_users_word_makes_another_pack(folder: Path, scene_config: config.Scene) -> None:
    plain = pack_scene(folder, scene_config)
    turned = pack_scene(folder, attrs.evolve(scene_config, flip="both"))
    assert np.array_equal(turned.views, plain.views[:, ::-1, ::-1])
    # Near and far exchanged: truth follows with its sign.
    assert (turned.disparity_min_px, turned.disparity_max_px) == (-2.0, 1.0)
    one = pack_scene(folder, attrs.evolve(scene_config, flip="rows"))
    assert one.disparity_source == "estimated"


def test_truth_holds_with_the_order_it_told(tmp_path: Path, scene_config: config.Scene) -> None:
    """An lf.h5 whose columns run the other way than the layout's: its own depth says so, and stays of use."""
    depth = (10 / (made.middle_disparity() + 3)).astype(np.float32)
    old_hci(tmp_path / "lf.h5", made.views(3, 3)[:, ::-1], depth)
    field = pack_scene(tmp_path / "lf.h5", scene_config)
    assert np.array_equal(field.views[0].transpose(0, 1, 3, 4, 2), made.views(3, 3))
    assert field.disparity_source == "truth"
    assert (field.disparity_min_px, field.disparity_max_px) == pytest.approx((-1, 2), abs=1e-4)


def test_gamma_grey_and_depth(tmp_path: Path, scene_config: config.Scene) -> None:
    grid = made.views(2, 2, 48, 64)
    values = np.repeat(grid[..., :1], 3, axis=-1).astype(np.uint16) * 4
    for r in range(2):
        for c in range(2):
            made.write_ppm(tmp_path / f"{r:03d}_{c:03d}.ppm", values[r, c], 1023)
    scene = attrs.evolve(scene_config, gamma=2.0)
    field = pack_scene(tmp_path, scene)
    assert (field.channels, field.manifest["bit_depth"], field.manifest["gamma"]) == (1, 10, 2.0)
    wanted = np.rint(255 * np.sqrt(values[..., 0] / 1023))
    assert np.array_equal(field.views[0, :, :, 0], wanted)


def test_one_coloured_view_makes_a_scene_coloured(tmp_path: Path, scene_config: config.Scene) -> None:
    grid = np.repeat(made.views(4, 4, 48, 64)[..., :1], 3, axis=-1)
    grid[1, 1, 5, 5] = (1, 2, 3)  # not among the views looked at first
    made.write_grid(tmp_path, grid)
    assert pack_scene(tmp_path, scene_config).channels == 3


def test_missing_corners_are_made_from_the_nearest_view(tmp_path: Path, scene_config: config.Scene) -> None:
    grid = made.views(5, 5, 48, 64)
    made.write_grid(tmp_path, grid, "{r:03d}_{c:03d}.png")
    (tmp_path / "000_000.png").unlink()
    field = pack_scene(tmp_path, attrs.evolve(scene_config, flip="none"))
    assert [tuple(place) for place in np.argwhere(~field.present)] == [(0, 0)]
    true, beside = grid[0, 0].transpose(2, 0, 1).astype(float), np.asarray(field.views[0, 0, 1], float)
    assert np.abs(field.views[0, 0, 0] - true).mean() < 0.6 * np.abs(beside - true).mean()


def test_video_and_single_picture(tmp_path: Path, scene_config: config.Scene) -> None:
    for n, near in enumerate((2.0, 1.5)):
        made.write(tmp_path / "video" / f"f{n}.png", made.mosaic(made.views(2, 3, 64, 80, near)))
    field = pack_scene(tmp_path / "video", scene_config)
    assert (field.frames, field.frame_rate_hz) == (2, 25.0)
    assert field.disparity is not None and field.disparity.shape[0] == 2
    made.write(tmp_path / "one" / "photo.png", made.texture(60, 80, 3))
    single = pack_scene(tmp_path / "one", scene_config)
    assert (single.rows, single.cols, single.disparity, single.method) == (1, 1, None, "nearest")


def _other_version(pack: Path) -> None:
    manifest = json.loads((pack / "manifest.json").read_text())
    (pack / "manifest.json").write_text(json.dumps({**manifest, "version": 99}))


DAMAGES: dict[str, Callable[[Path], object]] = {
    **{f"no {name}": lambda pack, name=name: (pack / name).unlink() for name in ("views.npy", "disparity.npy", "manifest.json")},
    "another version": _other_version,
    "cut": lambda pack: os.truncate(pack / "views.npy", 1000),
    "empty manifest": lambda pack: (pack / "manifest.json").write_text("{}"),
    **{
        f"{kind} as {name}": lambda pack, make=make, name=name: make(pack / name)
        for kind, make in NO_FILES.items()
        for name in ("views.npy", "manifest.json")
    },
}


def test_a_damaged_pack_is_refused_and_made_again(folder: Path, scene_config: config.Scene, tmp_path: Path) -> None:
    pack = Path(pack_scene(folder, scene_config).folder)
    for kind, damage in DAMAGES.items():
        damaged = shutil.copytree(pack, tmp_path / kind.replace("/", " "))
        damage(damaged)
        with pytest.raises(DamagedPackError):
            open_pack(damaged)
    os.truncate(pack / "views.npy", 1000)
    assert np.array_equal(pack_scene(folder, scene_config).views[0].transpose(0, 1, 3, 4, 2), made.views(3, 3))


def test_a_failure_half_way_leaves_nothing(folder: Path, scene_config: config.Scene) -> None:
    data = (folder / "input_Cam008.png").read_bytes()
    (folder / "input_Cam008.png").write_bytes(data[:2000] + bytes(100) + data[2100:])
    with pytest.raises(UserError, match=r"input_Cam008\.png.*truncated"):
        pack_scene(folder, scene_config)
    assert left_over(scene_config) == [] and cache.packs(scene_config) == []
    assert cache.find_pack(folder, scene_config) is None


def test_a_full_disk_is_told_with_sizes(folder: Path, scene_config: config.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packing.shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    with pytest.raises(UserError, match=r"takes \d+ MB.*has 0 MB free"):
        pack_scene(folder, scene_config)
    assert list((Path(scene_config.cache_dir) / "scenes").iterdir()) == []


HOLDER = (
    "import sys; from pathlib import Path; from lfpipe.scene.pack import open_pack\n"
    "field = open_pack(Path(sys.argv[1])); print('open', flush=True); sys.stdin.read()"
)


def test_a_pack_in_use_stays_until_nobody_has_it_open(folder: Path, scene_config: config.Scene) -> None:
    pack_scene(folder, scene_config)
    found = cache.packs(scene_config)[0][0]
    command = [sys.executable, "-c", HOLDER, str(found)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as session:
        assert session.stdout is not None and session.stdout.readline() == b"open\n"
        assert not cache.remove(found)
        assert open_pack(found).rows == 3
        session.kill()
    assert cache.remove(found)
    assert cache.packs(scene_config) == []
    assert cache.sweep(scene_config) == 1  # its line in the index
    with pytest.raises(DamagedPackError, match="no pack"):
        open_pack(found)


def test_scales_hold_the_range() -> None:
    assert scale_for(-3.1, 2.7) == 1 / 16
    for low, high in ((-14.6, 8.4), (-1.0, 30.0)):
        scale = scale_for(low, high)
        ends = quantised(np.array([low, high], np.float32), scale) * np.float32(scale)
        assert np.allclose(ends, (low, high), atol=scale / 2 + 1e-6)


def test_disparity_of_a_subset_of_views_is_per_its_own_step() -> None:
    grid = made.views(5, 5).transpose(0, 1, 4, 2, 3)
    found = estimate_disparity(grid[::2, ::2])
    assert found is not None and found.shape == (3, 3, 48, 64)
    assert np.median(np.abs(found[1, 1] - 2 * made.middle_disparity()[::2, ::2])) < 0.25
    assert estimate_disparity(grid[:1, :1]) is None
    assert estimate_disparity(grid[:, :, :, : SMALLEST_PX - 1]) is None


def test_cameras_off_the_grid_are_divided_by_their_true_distance() -> None:
    wall = made.texture(192, 256, 4)
    steps = np.array([0.0, 1.4, 2.0])  # the middle camera stands 0.4 of a step to the right
    views = np.array([[wall[40:136, 40 + round(5 * s) : 168 + round(5 * s)] for s in steps]]).transpose(0, 1, 4, 2, 3)
    offsets = np.zeros((1, 3, 2), np.float32)
    offsets[0, 1, 1] = 0.4
    told, blind = estimate_disparity(views, offsets), estimate_disparity(views)
    assert told is not None and blind is not None
    assert np.isnan(told).mean() < 0.01 and np.nanmean(np.abs(told - 5)) < 0.1
    assert np.nanmean(np.abs(blind - 5)) > 1, "if it is not marked as unknown"


def test_plane_file_in_pieces(tmp_path: Path) -> None:
    piece = np.arange(20, dtype=np.int16).reshape(4, 5)
    with PlaneFile(tmp_path / "a.npy", (2, 3, 4, 5), np.int16, create=True) as file:
        file.write((1, 2), piece)
        assert np.array_equal(file.read((1, 2)), piece)
    whole = np.load(tmp_path / "a.npy")
    assert np.array_equal(whole[1, 2], piece)
    assert not whole[0].any()


@pytest.mark.parametrize("name", ["hci_antinous", "hci_old_stillLife_3x3"])
def test_imported_disparity_lands_on_the_neighbours(name: str, scene_config: config.Scene) -> None:
    """The sign error would show: with the other sign the pictures differ several times as much."""
    if not (made.SAMPLES / name).is_dir():
        pytest.skip(f"sample scene {name} is not here")
    source = layouts.describe(made.SAMPLES / name, scene_config)
    row, col = source.middle
    truth, grey = source.truth[row, col](), grey_views(source)
    for down, across in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        right, wrong = (
            float(mismatch(grey(row, col), grey(row + down, col + across), sign * truth, down, across).mean()) for sign in (1, -1)
        )
        assert right < 6 and wrong > 2.5 * right


def test_half_a_pack_is_completed_and_never_whole(folder: Path, scene_config: config.Scene) -> None:
    class Stop(Exception):
        pass

    def stop(task: str, done: int, _total: int) -> None:
        if task == "disparity" and done == 3:
            raise Stop

    with pytest.raises(Stop):
        pack_scene(folder, scene_config, stop)
    found = cache.find_pack(folder, scene_config)
    assert found is not None and not open_pack(found).complete
    for name in ("disparity.npy", "interim.npy"):
        (found / name).write_bytes(b"half a file")
    views = (found / "views.npy").stat().st_mtime_ns
    done = pack_scene(folder, scene_config)
    assert done.complete and done.disparity is not None and (found / "views.npy").stat().st_mtime_ns == views


def test_the_first_picture_needs_the_views_in_the_middle_only(tmp_path: Path, scene_config: config.Scene) -> None:
    grid = made.views(5, 5)
    made.write_grid(tmp_path / "scene", grid, "input_Cam{n:03d}.png")
    made.write_pfm(tmp_path / "scene" / "gt_disp_lowres.pfm", made.middle_disparity())
    seen: list[LightField] = []

    def stop(pack: Path) -> None:
        field = open_pack(pack)
        assert not field.manifest["views"] and not field.complete
        assert np.array_equal(field.views[0, 2, 2], grid[2, 2].transpose(2, 0, 1))
        assert np.array_equal(field.views[0, 0, 0], grid[1, 2].transpose(2, 0, 1)), "a copy of the nearest one"
        seen.append(field)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pack_scene(tmp_path / "scene", scene_config, views_ready=stop)
    whole = pack_scene(tmp_path / "scene", scene_config)
    assert whole.complete and np.array_equal(whole.views[0].transpose(0, 1, 3, 4, 2), grid)
    assert whole.folder == seen[0].folder and left_over(scene_config) == []
