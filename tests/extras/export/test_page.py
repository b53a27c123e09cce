"""A light field as a web page: what a browser shows is what `render_view` draws, whatever draws it
there; the page is small, whole, and loads nothing.
"""

import base64
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import lfpipe
from lfpipe.cli.scene import scene as command
from lfpipe.config import Config
from lfpipe.extras.export import page
from lfpipe.extras.export.page import PageExport
from lfpipe.scene.lightfield import LightField
from tests.render import rendered
from tests.support.browser import Browser, missing

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
    words = ["export", "page", "demo:marbles", "-o", str(path)]
    with pytest.MonkeyPatch.context() as small:  # a renderer in software draws it
        small.setattr(page, "MAX_PX", 10_000_000)
        done = CliRunner().invoke(
            command, [*words, "--set", FLAT, "--set", f"scene.cache_dir={cache}"]
        )
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert re.search(r"marbles\.html  \d\.\d\d MB, \d+x\d+ views of \d+x\d+ px", done.output)
    return path


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


@pytest.mark.parametrize(("most_bytes", "fewer"), [(50_000, True), (page.MAX_BYTES, False)])
def test_a_page_names_nobody_else_and_has_fewer_views_if_it_would_be_too_large(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most_bytes: int, fewer: bool
) -> None:
    field = rendered.field(5, 5, 96, 128, texture=0.4)
    monkeypatch.setattr(page, "MAX_BYTES", most_bytes)
    quilt = PageExport(field, Config()).write(tmp_path / "x.html", "<b>A & B</b>")
    text = (tmp_path / "x.html").read_text()
    assert len(text) <= page.MAX_BYTES
    assert (quilt.wanted != (quilt.rows, quilt.cols)) is fewer
    assert quilt.fits and quilt.across * quilt.down >= quilt.rows * quilt.cols
    assert "&lt;b&gt;A &amp; B&lt;/b&gt;" in text and "<b>A" not in text
    outside = re.sub(r"base64,[^\"]+", "", text)
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", outside, re.IGNORECASE)
    assert "default-src 'none'" in text
