"""The docs as a site: it has every page, every link works, and its drawing equals the tool's."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def test_the_site_builds_with_strict_links(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path / "site")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {page.stem for page in (tmp_path / "site").glob("*.html")}
    assert {page.stem for page in (ROOT / "docs").glob("*.md")} <= pages


def test_links_within_the_repository_hold() -> None:
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")):
        for target in LINK.findall(page.read_text()):
            if not re.match(r"[a-z]+:|#", target):
                assert (page.parent / target.partition("#")[0]).exists(), f"{page.name}: {target}"


def test_the_drawing_of_the_set_up_is_what_the_tool_draws(tmp_path: Path) -> None:
    subprocess.run([sys.executable, ROOT / "tools" / "draw_setup.py", "--out", tmp_path / "setup.svg"], check=True)
    drawn, kept = ((path / "setup.svg").read_text() for path in (tmp_path, ROOT / "docs"))
    assert drawn.count("<path") == kept.count("<path") and "<svg" in drawn
