"""Plug-ins that fail are named with their package."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from lfpipe.capture.spec import parse_source
from lfpipe.config import Scene, Track
from lfpipe.errors import UserError
from lfpipe.plugins import ENGINES, FILTERS, LAYOUTS, SOURCES, entries
from lfpipe.scene import layouts
from lfpipe.track.engine import make_engine
from lfpipe.track.filters.base import make_filter
from tests.scene import made
from tests.support.refusal import refusal
from tests.support.world import write_package

MODULE = """
import sys

NAME = "bad"

def detect(listing):
    {detect}

def describe(listing, scene):
    {describe}

def raising(*_):
    sys.exit(3)
"""
Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs a package `bad 1.0` with one module and these entry points."""

    def installed(offered: dict[str, str], head: str = "", **bodies: str) -> None:
        folder = tmp_path / "packages"
        groups = "".join(f"[{group}]\n{entry}\n" for group, entry in offered.items())
        write_package(folder, groups, "bad")
        usual = {"detect": "return 99", "describe": "return 1"}
        (folder / "bad_parts.py").write_text(head + MODULE.format(**usual | bodies))
        monkeypatch.syspath_prepend(folder)
        monkeypatch.delitem(sys.modules, "bad_parts", raising=False)
        entries.cache_clear()

    yield installed
    entries.cache_clear()


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ({"detect": "raise KeyError(1)"}, "KeyError: 1"),
        ({"detect": "return 'yes'"}, "TypeError"),
        ({"describe": "raise OSError"}, "OSError"),
        ({"describe": "return None"}, "AttributeError"),
        ({"head": "import sys; sys.exit(0)"}, "SystemExit: 0"),
    ],
)
def test_plugin_layout_that_fails_is_named(
    install: Install, tmp_path: Path, fault: dict[str, str], why: str
) -> None:
    install({LAYOUTS: "bad = bad_parts"}, **fault)
    scene = made.write_grid(tmp_path / "png", made.wall(2, 2, 32, 40))
    refused = refusal(layouts.describe, scene, Scene())
    assert f"bad of bad 1.0 (lfpipe.layouts): {why}" in refused.message
    assert refused.remedy == "repair or uninstall bad"


def test_plugin_with_the_name_of_a_built_in_part_is_not_used(install: Install) -> None:
    install({LAYOUTS: "array = bad_parts"})
    assert layouts.layouts()["array"] is layouts.built_in()["array"]


def test_plugin_engine_filter_or_source_that_fails_is_named(install: Install) -> None:
    install({group: "bad = bad_parts:raising" for group in (ENGINES, FILTERS, SOURCES)})
    with pytest.raises(UserError, match=r"bad of bad 1\.0 \(lfpipe\.engines\): SystemExit: 3"):
        make_engine(Track(engine="bad"))  # type: ignore[arg-type]
    with pytest.raises(UserError, match=r"bad of bad 1\.0 \(lfpipe\.filters\): SystemExit: 3"):
        make_filter(Track(filter="bad"))
    with pytest.raises(UserError, match=r"bad of bad 1\.0 \(lfpipe\.sources\): AttributeError"):
        parse_source("bad:")
