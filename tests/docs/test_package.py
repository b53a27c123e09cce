"""The package as an installer gets it: built from the project's files, unpacked and read."""

import re
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from tests.docs.conftest import BUILD, ROOT


@pytest.fixture(scope="module", params=["", "served.example/lfpipe"])
def package(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[str], str]:
    """(address of the files, names in the source distribution, its metadata)."""
    out = tmp_path_factory.mktemp("dist")
    url = f"https://{request.param}" if request.param else ""
    env = {"PATH": "/usr/bin:/bin", "HOME": str(out), **({"LFPIPE_URL": url} if url else {})}
    done = subprocess.run([sys.executable, "-c", BUILD, "sdist", str(out)], cwd=ROOT, capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stderr
    with tarfile.open(next(out.glob("*.tar.gz"))) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
        found = next(member for member in archive if re.fullmatch("[^/]+/PKG-INFO", member.name))
        about = archive.extractfile(found)
        assert about is not None
        return url, names, about.read().decode()


def test_the_package_names_licence_and_authors_shows_nobody_and_links_to_what_exists(package: tuple[str, list[str], str]) -> None:
    url, names, about = package
    assert "LICENSE" in names and "Containerfile" in names and "lfpipe/cli/up.py" in names and "tests/world.py" in names
    assert "docs/page.png" not in names, "it shows a person"
    assert not any(name.startswith(("profiling/results", "lfpipe-")) for name in names)
    assert "License-Expression: Apache-2.0" in about and "Author: the lfpipe developers" in about
    assert "Apache License" in (ROOT / "LICENSE").read_text() and "Apache-2.0" in (ROOT / "CITATION.cff").read_text()
    targets = re.findall(r"\]\(([^)]+)\)", about)
    assert all(target.startswith("https://") for target in targets), targets
    assert ("![" in about) == bool(url) == ("Project-URL" in about)
    assert "lfpipe up --demo" in about and "## How it is built" in about


def test_the_container_runs_commands_that_exist() -> None:
    text = (ROOT / "Containerfile").read_text()
    assert re.search(r"^FROM python:3\.1[1-4]-slim$", text, re.M) and '"lfpipe", "up", "--demo"' in text and "pytest" in text


@pytest.mark.live
def test_a_wheel_from_the_source_distribution_installs_into_an_empty_environment(fresh: Path, tmp_path: Path) -> None:
    """As an installer without a wheel does: the archive has all that its own build reads."""
    code = "import lfpipe, subprocess; print(lfpipe.__file__); subprocess.run(['lfpipe', '--version'], check=True)"
    env = {"PATH": f"{fresh.parent}:/usr/bin:/bin", "HOME": str(tmp_path)}
    done = subprocess.run((fresh, "-c", code), cwd=tmp_path, capture_output=True, text=True, env=env)
    assert done.returncode == 0 and str(fresh.parents[1]) in done.stdout and "lfpipe, version" in done.stdout, done.stderr
