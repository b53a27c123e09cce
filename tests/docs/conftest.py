"""What pages hold, and an environment as a person has it who never heard of uv."""

import functools
import re
import sys
import sysconfig
import tarfile
from pathlib import Path

import pytest

from tests.support.processes import printed

ROOT = Path(__file__).parents[2]
PAGES = ["README.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))]
BUILD = (
    "import sys; from hatchling import build; getattr(build, 'build_' + sys.argv[1])(sys.argv[2])"
)


def blocks(page: str, language: str = "python") -> list[str]:
    """The fenced blocks of that language on a page of the repository."""
    return re.findall(rf"^```{language}\n(.*?)^```", (ROOT / page).read_text(), re.M | re.S)


@pytest.fixture(scope="session")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of a new environment, made by `python -m venv`, into which pip installed a wheel
    built from the source distribution. Its dependencies are those of the present environment, by a
    .pth file, so that no index is needed.
    """
    folder = tmp_path_factory.mktemp("fresh")

    env = {"PATH": "/usr/bin:/bin", "HOME": str(folder)}
    run = functools.partial(printed, cwd=folder, env=env)
    run(sys.executable, "-c", BUILD, "sdist", folder, cwd=ROOT)
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        archive.extractall(folder, filter="data")
    run(
        sys.executable,
        "-c",
        BUILD,
        "wheel",
        folder,
        cwd=next(path for path in folder.iterdir() if path.is_dir()),
    )
    run(sys.executable, "-m", "venv", folder / "env")
    python = folder / "env" / "bin" / "python"
    run(python, "-m", "pip", "install", "-q", "--no-deps", "--no-index", next(folder.glob("*.whl")))
    site = next((folder / "env" / "lib").glob("python*/site-packages"))
    (site / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    return python
