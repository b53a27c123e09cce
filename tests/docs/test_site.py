"""The docs: their links and files exist, and their pictures show what there is."""

import json
import re
from pathlib import Path

from tests.support.extras import with_extras

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
FILE = re.compile(r"(?<![\w./~-])([\w-]+(?:/[\w.-]+)*/[\w-]+\.(?:py|toml|sh|yml))\b")


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
            folders = ROOT, ROOT / "lfpipe", ROOT / "tests"
            assert any((folder / name).exists() for folder in folders), f"{page.name}: {name}"


@with_extras
def test_pictures_of_the_docs_show_the_interface_of_today() -> None:
    """The letters of another version of pygame-ce are drawn otherwise."""
    from tools.make_docs_pictures import digests

    stored = json.loads((ROOT / "docs" / "pictures.json").read_text())
    now = digests()
    for digest_of in (stored, now):
        if stored["pygame-ce"] != now["pygame-ce"]:
            del digest_of["window"]
    stored["pygame-ce"] = now["pygame-ce"]
    assert now == stored, "python -m tools.make_docs_pictures monitor window interface"
