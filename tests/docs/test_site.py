"""The docs as a site: it has every page, every link works, and one address of the project."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.browser import Browser, missing
from tests.support.processes import printed

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
FILE = re.compile(r"(?<![\w./~-])([\w-]+(?:/[\w.-]+)*/[\w-]+\.(?:py|toml|sh|yml))\b")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the built site."""
    folder = tmp_path_factory.mktemp("docs") / "site"
    printed(sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", folder, cwd=ROOT)
    return folder


def test_site_has_every_page(site: Path) -> None:
    assert {page.stem for page in (ROOT / "docs").glob("*.md")} <= {
        page.stem for page in site.glob("*.html")
    }


def brightness(browser: Browser, name: str) -> int:
    """Of a colour of the page's body: the sum of red, green and blue."""
    return sum(
        int(value)
        for value in re.findall(r"\d+", browser.ask(f"getComputedStyle(document.body).{name}"))[:3]
    )


@pytest.mark.live
def test_site_pages_fit_their_screen(site: Path, tmp_path: Path) -> None:
    """On a desktop and on a phone, light and dark; and the text differs from its background."""
    if why := missing():
        pytest.skip(why)
    with Browser(tmp_path) as browser:
        for width_px, dark in ((1280, False), (375, True)):
            browser.show_as(width_px, dark)
            for page in sorted(site.glob("*.html")):
                browser.open(page.as_uri())
                content = (
                    "document.documentElement.scrollWidth - document.documentElement.clientWidth"
                )
                assert browser.ask(content) <= 0, f"{page.name} overflows at {width_px} px"
                cut = (
                    "[...document.querySelectorAll('table')].filter(t => t.offsetWidth >"
                    " t.parentElement.clientWidth + 1)"
                )
                assert browser.ask(f"{cut}.length") == 0, (
                    f"{page.name}: a table is cut off at {width_px} px"
                )
            ink, paper = (brightness(browser, name) for name in ("color", "backgroundColor"))
            assert (paper > ink) != dark, (ink, paper)


def test_docs_links_and_files_exist() -> None:
    results = ROOT / "profiling" / "results"
    for page in (
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *(ROOT / "docs").glob("*.md"),
        *results.glob("*.md"),
    ):
        text = page.read_text()
        for target in LINK.findall(text):
            if not re.match(r"[a-z]+:|#", target):
                assert (page.parent / target.partition("#")[0]).exists(), f"{page.name}: {target}"
        for name in FILE.findall(text):
            if "extras/" in name and not (ROOT / "lfpipe" / "extras").exists():
                continue  # the core without its extras
            assert any((folder / name).exists() for folder in (ROOT, ROOT / "lfpipe")), (
                f"{page.name}: {name}"
            )


WRITTEN_BY_HAND = 14_000  # words, with a letter or a digit
GENERATED = ("commands.md", "configuration.md", "reference.md")


def test_docs_stay_short() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    words = {
        page.name: sum(any(map(str.isalnum, word)) for word in page.read_text().split())
        for page in pages
    }
    assert sum(words[name] for name in words if name not in GENERATED) <= WRITTEN_BY_HAND


def test_docs_name_one_address_and_one_date_of_the_release() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    address = project["urls"]["Source"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"repository-code: {address}\n" in citation
    assert f"version: {project['version']}\n" in citation
    changes = (ROOT / "CHANGELOG.md").read_text()
    (date,) = re.findall(rf"## {project['version']}, (\d{{4}}-\d\d-\d\d)\n", changes)
    assert f"date-released: {date}\n" in citation
    assert max(map(len, changes.splitlines())) <= 100
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), ROOT / "examples" / "replay.yml"]
    named = re.compile(r"(?:git\+|git clone )(https://[^\s`]+)")
    assert {name for page in pages for name in named.findall(page.read_text())} == {address}
