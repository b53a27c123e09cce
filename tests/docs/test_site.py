"""The docs as a site: it has every page, every link works, and one address of the project."""

import re
from pathlib import Path

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
