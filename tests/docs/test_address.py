"""The address of the project: one, wherever it stands."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_page_names_the_address_of_the_project_file() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    address = project["urls"]["Source"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"repository-code: {address}\n" in citation
    assert f"version: {project['version']}\n" in citation
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    named = {
        name for page in pages for name in re.findall(r"git\+(https://[^\s`]+)", page.read_text())
    }
    assert named == {address}
