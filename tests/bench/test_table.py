"""The protocol of angular super-resolution: figures equal to scikit-image's, the views that papers keep, resumed runs."""

from pathlib import Path

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.color import rgb2ycbcr
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from lfpipe.bench import table as metrics
from lfpipe.bench.table import FILE, TEST_SCENES, Line, Protocol, axis, grid_of, markdown, measure, set_means, write
from lfpipe.errors import UserError
from lfpipe.scene.lightfield import LightField
from tests.bench.inputs import wall
from tests.world import World, write_scene


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(56, 90), st.integers(56, 90), st.floats(0.1, 60), st.integers(0, 22))
def test_figures_are_those_of_scikit_image(seed: int, height: int, width: int, noise: float, border_px: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.integers(0, 256, (3, height, width), np.uint8)
    b = np.clip(a + rng.normal(0, noise, a.shape), 0, 255).astype(np.uint8)
    luma = [metrics.studio_luma(p) for p in (a, b)]
    theirs = [rgb2ycbcr(p.transpose(1, 2, 0))[..., 0] for p in (a, b)]
    np.testing.assert_allclose(luma, theirs, rtol=0, atol=1e-11)
    x, y = (metrics.shaved(one, border_px) for one in luma)
    if (x != y).any():
        assert metrics.psnr_db(x, y) == pytest.approx(peak_signal_noise_ratio(x, y, data_range=255), abs=1e-10)
    expected = structural_similarity(x, y, data_range=255, gaussian_weights=True, sigma=1.5, use_sample_covariance=False)
    assert metrics.ssim(x, y) == pytest.approx(expected, abs=1e-12)


def test_grey_counts_as_three_equal_channels() -> None:
    grey = np.arange(256, dtype=np.uint8).reshape(1, 16, 16)
    np.testing.assert_allclose(metrics.studio_luma(grey), metrics.studio_luma(np.repeat(grey, 3, axis=0)), atol=1e-12)
    assert metrics.studio_luma(grey).min() == 16 and metrics.studio_luma(grey).max() == pytest.approx(235)
    with pytest.raises(ValueError, match="too small"):
        metrics.shaved(np.zeros((50, 50)), 22)


def test_kept_views() -> None:
    assert axis(9, 2, "central") == (1, 6) and axis(9, 2, "top-left") == (0, 6) and axis(9, 3, "central") == (1, 3)
    assert axis(7, 2, "central") == (0, 6) and axis(17, 2, "central") == (5, 6) and axis(3, 2, "central") == (0, 2)
    assert axis(1, 2, "central") == (0, 0)
    with pytest.raises(ValueError, match="none lies between"):
        axis(2, 2, "central")
    assert grid_of(wall(1, 9), Protocol()) == ((0, 1), (1, 2), 6)
    with pytest.raises(ValueError, match="one view"):
        grid_of(wall(1, 1), Protocol())


def _run(out: Path, fields: list[LightField], protocol: Protocol | None = None) -> tuple[list[Line], int]:
    said: list[str] = []
    scenes = [(Path(f"s{k}"), lambda field=field: field) for k, field in enumerate(fields)]
    lines = measure(scenes, protocol or Protocol(border_px=8), "x", out, lambda what, *_: said.append(what))  # type: ignore[arg-type]
    return lines, len(said)


def test_methods_beside_each_other_and_taken_up_again(tmp_path: Path) -> None:
    field = wall(9, 9, 96)
    lines, made = _run(tmp_path, [field])
    assert [line.method for line in lines] == ["nearest", "blend", "warp", "warp2", "best"] and made == 45 * len(lines)
    assert all(line.grid == "2x2 -> 7x7" and line.ms > 0 and line.mb > 0.1 for line in lines)
    db = {line.method: line.psnr_db for line in lines}
    assert min(db["warp2"], db["best"]) > db["blend"] > db["nearest"]
    again, made = _run(tmp_path, [field])
    assert again == lines and made == 0
    file = tmp_path / FILE
    file.write_text(file.read_text()[:-20])  # killed while the last line was written
    third, made = _run(tmp_path, [field])
    assert made == 45 and [line.psnr_db for line in third] == [line.psnr_db for line in lines]
    fourth, made = _run(tmp_path, [field])
    assert fourth == third and made == 0
    other, made = _run(tmp_path, [field], Protocol(3, "top-left", 8))
    assert made and other[0].grid == "3x3 -> 7x7"


def test_what_cannot_be_measured_is_a_line_with_its_reason(tmp_path: Path) -> None:
    def missing() -> LightField:
        raise UserError("nowhere: no such folder", "")

    lines = measure([(Path("nowhere"), missing)], Protocol(), "x", tmp_path, lambda *_: None)
    small, _ = _run(tmp_path, [wall(2, 2)])
    tiny, _ = _run(tmp_path, [wall(9, 9, 50)], Protocol())
    hole = wall(9, 9, 96)
    hole.present[1, 1] = False
    holed, _ = _run(tmp_path, [hole])
    reasons = [line.left_out for line in (*lines, *small, *tiny, *holed)]
    words = ("no such", "between", "too small", "missing")
    assert all(word in reason for word, reason in zip(words, reasons, strict=True)), reasons
    assert "no such folder" in write(lines, Protocol(), tmp_path).read_text()


def test_flat_scenes_have_no_warps(tmp_path: Path) -> None:
    lines, _ = _run(tmp_path, [wall(3, 3, 64, disparity=False)])
    assert [line.method for line in lines] == ["nearest", "blend"] and lines[0].grid == "2x2 -> 3x3"


def test_no_mean_beside_printed_means_unless_all_scenes_are_there(tmp_path: Path) -> None:
    line = Line("buddha", "warp2", "2x2 -> 7x7", 42.0, 0.97, 40.0, 1.5, 9.0)
    lines = [attrs.evolve(line, scene=name) for name in TEST_SCENES["HCI old"]]
    assert not set_means(lines[:-1]) and "mean of" not in markdown(lines[:-1], Protocol())
    assert set_means(lines)[0][:4] == ("mean of HCI old", "2x2 -> 7x7", "warp2", "42.00")
    assert not set_means([attrs.evolve(one, grid="3x3 -> 7x7") for one in lines])
    text = markdown(lines, Protocol())
    assert "not run here" in text and "38.81" in text and "not run here" not in markdown(lines, Protocol(keep=3))
    page = write(lines, Protocol(), tmp_path).read_text()
    assert "not run here" in page


def test_from_the_command_line(world: World) -> None:
    scene = write_scene(world.root / "scene", 3, 3)
    done = world.run("bench", "table", scene, "--border", "4", "--out", "t")
    assert done.returncode == 0 and "2x2 -> 3x3" in done.stdout and "t/table.html" in done.stdout, done.stderr
    bad = world.run("bench", "table", scene, "nowhere", "--border", "4", "--out", "t")
    assert bad.returncode == 1 and "nowhere" in bad.stdout and "Traceback" not in bad.stderr
