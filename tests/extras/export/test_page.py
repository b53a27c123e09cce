"""A light field as a web page: what a browser shows is what `render_view` draws, whatever draws it
there; the page is small, whole, and loads nothing.
"""

import base64
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import lfpipe
from lfpipe.cli.scene import scene as command
from lfpipe.config import Config, Render, Scene
from lfpipe.extras.export import page
from lfpipe.extras.export.page import PageExport, check_page
from lfpipe.scene.lightfield import UNKNOWN, LightField
from tests.render import rendered
from tests.support.browser import Browser, missing
from tests.support.refusal import refusal

SURE = "--set", "scene.invert_depth=no"
FLAT = "render.zero_plane_px=0"


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def field(cache: str) -> LightField:
    return lfpipe.open_scene("demo:marbles", {"scene.cache_dir": cache})


@pytest.fixture(scope="module")
def written(cache: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "marbles.html"
    words = ["export", "page", "demo:marbles", "-o", str(path), "--credit", "<b>A & B</b>"]
    with pytest.MonkeyPatch.context() as small:  # a renderer in software draws it
        small.setattr(page, "MAX_PX", 10_000_000)
        done = CliRunner().invoke(
            command, [*words, "--set", FLAT, "--set", f"scene.cache_dir={cache}"]
        )
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert re.search(r"marbles\.html  \d\.\d\d MB, \d+x\d+ views of \d+x\d+ px", done.output)
    return path


def test_a_page_is_one_small_file_that_names_nobody_else(written: Path) -> None:
    text = written.read_text()
    assert len(text) <= page.MAX_BYTES
    assert "&lt;b&gt;A &amp; B&lt;/b&gt;" in text and "<b>A" not in text
    outside = re.sub(r"base64,[^\"]+", "", text)
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", outside, re.IGNORECASE)
    assert "default-src 'none'" in text


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if why := missing():
        pytest.skip(why)
    flags = "--enable-unsafe-swiftshader", "--force-prefers-reduced-motion"
    with Browser(tmp_path_factory.mktemp("profile"), *flags) as opened:
        yield opened


def opened(browser: Browser, path: Path, how: str) -> None:
    """Opens the page, drawn by webgl or canvas, at rest."""
    browser.open("about:blank")  # another part of one page would not be loaded anew
    browser.open(f"{path.as_uri()}#{how}")
    browser.until("typeof draw !== 'undefined' && draw !== null")
    browser.ask("(moved = true)")


def shown(browser: Browser, row: float, col: float) -> NDArray[np.uint8]:
    """What the page's picture holds for a viewpoint of the page's grid."""
    url = browser.ask(f"(look({row}, {col}), canvas.toDataURL())")
    data = base64.b64decode(url.partition(",")[2])
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), np.uint8)


@pytest.mark.parametrize("how", ["webgl", "canvas"])
def test_a_browser_shows_what_render_view_draws(
    browser: Browser, field: LightField, written: Path, how: str
) -> None:
    opened(browser, written, how)
    assert browser.ask("canvas.getContext('webgl2') ? 'webgl' : 'canvas'") == how
    about = browser.ask("scene")
    size = (about["width"], about["height"])
    steps = [(about[axis] - 1) / (getattr(field, axis) - 1) for axis in ("rows", "cols")]
    for row, col in ((0, 0), (field.rows - 1, field.cols - 1), (4, 4), (2.3, 5.6), (6.9, 0.4)):
        whole = lfpipe.render_view(field, row, col)
        wanted = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
        picture = shown(browser, row * steps[0], col * steps[1])
        assert picture.shape == wanted.shape
        # without WebGL 2 cross-faded
        assert cv2.PSNR(picture, wanted) > (32 if how == "webgl" else 27), (row, col)
        eye_distance = lfpipe.render_view(field, field.rows - 1 - row, 8 - col if col != 4 else 0)
        other = cv2.resize(eye_distance, size, interpolation=cv2.INTER_AREA)
        assert cv2.PSNR(picture, wanted) > cv2.PSNR(picture, other) + 3
    assert browser.ask("performance.getEntriesByType('resource').length") == 0


SHAPES = {"near cameras": (5, 5, 2.0), "cameras far apart": (3, 3, 4.0), "one row": (1, 4, 2.0)}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_page_is_nearer_to_the_true_view_than_a_cross_fade(
    browser: Browser, tmp_path: Path, shape: str
) -> None:
    rows, cols, scale = SHAPES[shape]
    size = 96, 128
    path = tmp_path / "page.html"
    made = rendered.field(rows, cols, *size, scale=scale, texture=0.4)
    PageExport(made, Config(render=Render(zero_plane_px=0.0))).write(path)
    for row, col in ((0.5, 1.5), (0.3, 1.3), (0.5, 1.25)):
        row = row if rows > 1 else 0.0
        steps = (row - (rows - 1) / 2) * scale, (col - (cols - 1) / 2) * scale
        true = rendered.view(*steps, *size, texture=0.4)[::-1].transpose(1, 2, 0)
        db = {}
        for how in ("webgl", "canvas"):
            opened(browser, path, how)
            db[how] = cv2.PSNR(shown(browser, row, col), np.ascontiguousarray(true))
        assert db["webgl"] > db["canvas"] + 2, (row, col)


def test_a_page_cross_fades_where_disparity_is_unknown(browser: Browser, tmp_path: Path) -> None:
    known = rendered.field(3, 3, 96, 128, scale=4.0, texture=0.4)
    assert known.disparity is not None
    disparity = known.disparity.copy()
    disparity[..., :20] = UNKNOWN
    pictures = {}
    for name, how, field in (
        ("some", "webgl", attrs.evolve(known, disparity=disparity)),
        ("none", "webgl", attrs.evolve(known, disparity=None)),
        ("none", "canvas", attrs.evolve(known, disparity=None)),
        ("all", "webgl", known),
    ):
        path = tmp_path / f"{name}.html"
        config = Config(render=Render(zero_plane_px=0.0, method="warp2"))
        PageExport(field, config).write(path)
        opened(browser, path, how)
        pictures[name, how] = shown(browser, 0.5, 1.5).astype(float)
    faded = pictures["none", "webgl"]
    assert np.abs(faded - pictures["none", "canvas"]).mean() < 2  # which rounds after each view
    mixed, warped = pictures["some", "webgl"], pictures["all", "webgl"]
    left, right = np.s_[:, :30], np.s_[:, 60:]  # 20 values of disparity are 40 pixels
    assert np.abs(mixed - faded)[left].mean() < 0.5 < np.abs(warped - faded)[left].mean()
    assert np.abs(mixed - warped)[right].mean() < 0.5 < np.abs(warped - faded)[right].mean()


@pytest.mark.parametrize("how", ["webgl", "canvas"])
def test_the_button_gives_each_eye_its_colour(
    browser: Browser, field: LightField, written: Path, how: str
) -> None:
    opened(browser, written, how)
    browser.click("button")
    about = browser.ask("scene")
    middle = (about["rows"] - 1) / 2, (about["cols"] - 1) / 2
    picture = shown(browser, *middle)
    browser.click("button")
    half = about["apart"] / 2
    assert half > 0
    left, right = (shown(browser, middle[0], middle[1] + side) for side in (-half, half))

    def alike(a: NDArray[np.uint8], b: NDArray[Any]) -> float:
        return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])

    grey = [cv2.cvtColor(eye, cv2.COLOR_BGR2GRAY) for eye in (left, right)]
    assert alike(picture[..., 2], grey[0]) > alike(picture[..., 2], grey[1]) + 0.01
    assert alike(picture[..., 0], grey[1]) > alike(picture[..., 0], grey[0]) + 0.01


def test_a_renderer_in_software_is_left_alone(browser: Browser, written: Path) -> None:
    opened(browser, written, "")
    assert browser.ask("canvas.getContext('2d') ? 'canvas' : 'webgl'") == "canvas"


def test_mouse_and_keys_move_the_viewpoint(browser: Browser, written: Path) -> None:
    opened(browser, written, "webgl")
    browser.ask("(window.box = canvas.getBoundingClientRect(), null)")
    for x, y in ((0.25, 0.5), (0.75, 0.1)):
        at = f"clientX: box.left + {x} * box.width, clientY: box.top + {y} * box.height"
        event = f"new PointerEvent('pointermove', {{pointerType: 'mouse', {at}}})"
        browser.ask(f"(dispatchEvent({event}), null)")
        place, last = browser.ask("place"), browser.ask("last")
        assert place == pytest.approx([y * last[0], x * last[1]], abs=0.05)
    before = browser.ask("place[1]")
    key = "new KeyboardEvent('keydown', {key: 'ArrowLeft'})"
    assert browser.ask(f"(canvas.dispatchEvent({key}), place[1])") < before


def test_export_says_what_is_undecided_and_what_was_left_out(tmp_path: Path, cache: str) -> None:
    """A page of one pair out of two, or with near and far swapped, was written without a word."""
    chance = np.random.default_rng(1)
    pairs, out = tmp_path / "pairs", tmp_path / "a & b.html"
    pairs.mkdir()
    for name in "ab":
        base = cv2.GaussianBlur(chance.integers(0, 256, (48, 80, 3), np.uint8), (0, 0), 2)
        for at, side in enumerate(("left", "right")):
            cv2.imwrite(str(pairs / f"{name}_{side}.png"), base[:, 4 * at : 4 * at + 64])
    words = ["export", "page", str(pairs), "-o", str(out), "--set", f"scene.cache_dir={cache}"]
    done = CliRunner().invoke(command, words)
    assert "warning: 2 of 4 files used; the others are b_left.png" in done.stderr, done.output
    assert "near and far" not in done.stderr, "the names say which is left"
    assert '<iframe src="a%20%26%20b.html" title="' in done.stdout
    grid = tmp_path / "grid"
    grid.mkdir()
    base = cv2.GaussianBlur(chance.integers(0, 256, (60, 80, 3), np.uint8), (0, 0), 2)
    for row in range(3):
        for col in range(3):
            view = base[4 - row : 52 - row, 6 - col : 70 - col]
            cv2.imwrite(str(grid / f"view_{row}_{col}.png"), view)
    words[2:3] = [str(grid), "--overwrite"]
    said = [CliRunner().invoke(command, [*words, *more]).stderr for more in ((), (*SURE,))]
    assert ["near and far may be swapped" in text for text in said] == [True, False]


@pytest.mark.parametrize(("most_bytes", "fewer"), [(50_000, True), (page.MAX_BYTES, False)])
def test_a_page_that_would_be_too_large_has_fewer_views(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most_bytes: int, fewer: bool
) -> None:
    field = rendered.field(5, 5, 96, 128, texture=0.4)
    monkeypatch.setattr(page, "MAX_BYTES", most_bytes)
    quilt = PageExport(field, Config()).write(tmp_path / "x.html")
    assert (tmp_path / "x.html").stat().st_size <= most_bytes
    assert (quilt.wanted != (quilt.rows, quilt.cols)) is fewer
    assert quilt.fits and quilt.across * quilt.down >= quilt.rows * quilt.cols


def test_any_scene_has_a_page(tmp_path: Path, cache: str) -> None:
    picture = np.random.default_rng(1).integers(0, 255, (1, 1, 40, 60, 3), np.uint8)
    one = lfpipe.open_scene(picture, {"scene.cache_dir": cache})
    PageExport(one, Config()).write(tmp_path / "one.html")
    (found,) = re.findall(r"scene = (\{.*\});", (tmp_path / "one.html").read_text())
    about = json.loads(found)
    assert (about["rows"], about["cols"], about["apart"]) == (1, 1, 0)
    for name in ("x.png", "x"):
        assert "not .html" in str(refusal(check_page, tmp_path / name))
    assert Scene().cache_dir == ""
