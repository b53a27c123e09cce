"""Plug-ins that fail: named with their package, and skipped if alternatives exist."""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import NoneType

import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.spec import parse_source
from lfpipe.config import Scene, Track
from lfpipe.config.modes import Plugin
from lfpipe.errors import UserError
from lfpipe.monitor.doctor import plugin_check
from lfpipe.plugins import DISPLAYS, ENGINES, LAYOUTS, SOURCES, PluginError, entries, load, loaded
from lfpipe.render.display.open_display import open_display, parse_display
from lfpipe.scene import layouts
from lfpipe.track.filters.table import make_filter
from lfpipe.track.make_engine import make_engine
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

def scene_of(listing, **wrong):
    from lfpipe.scene.source import SceneSource

    usual = {{"rows": 1, "cols": 2, "height_px": 4, "width_px": 5}}
    return SceneSource(
        layout="bad", path=listing.path, files=(), read=lambda *_: 3, **usual | wrong
    )

class Engine:
    name, model, rotated_deg = "bad", "none", 0
    examine = reset = close = lambda *_: None

    def __init__(self, track):
        pass

    def detect(self, image):
        {engine}

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
        usual = {"detect": "return 99", "describe": "return 1", "engine": "return 1"}
        (folder / "bad_parts.py").write_text(head + MODULE.format(**usual | bodies))
        monkeypatch.syspath_prepend(folder)
        monkeypatch.delitem(__import__("sys").modules, "bad_parts", raising=False)
        entries.cache_clear()

    yield installed
    entries.cache_clear()


@pytest.mark.parametrize(
    "fault",
    [
        {"detect": "raise KeyError(1)"},
        {"detect": "sys.exit(1)"},
        {"detect": "return 'yes'"},
        {"describe": "raise MemoryError"},
        {"describe": "return None"},
        {"describe": "return scene_of(listing, rows=-1)"},
        {"describe": "return scene_of(listing, width_px=0)"},
        {"head": "import sys; sys.exit(0)"},
        {"head": "raise GeneratorExit"},
    ],
)
def test_plugin_layout_that_fails_is_named_and_skipped(
    install: Install, tmp_path: Path, fault: dict[str, str]
) -> None:
    install({LAYOUTS: "bad = bad_parts"}, **fault)
    scene = made.write_grid(tmp_path / "png", made.wall(2, 2, 32, 40))
    source = layouts.describe(scene, Scene())
    assert (source.rows, source.cols) == (2, 2)
    if "describe" in fault:
        assert any("bad of bad 1.0" in note for note in source.notes)
        refused = refusal(layouts.describe, scene, Scene(layout="bad"))
        assert "bad of bad 1.0" in refused.message
        assert refused.remedy == "repair or uninstall bad"
    else:
        assert "bad of bad 1.0" in plugin_check(LAYOUTS, "bad", "bad 1.0").detail


def test_plugin_view_that_is_no_array_names_its_package(install: Install, tmp_path: Path) -> None:
    install({LAYOUTS: "bad = bad_parts"}, describe="return scene_of(listing)")
    scene = made.write_grid(tmp_path / "png", made.wall(2, 2, 32, 40))
    source = layouts.describe(scene, Scene(layout="bad"))
    with pytest.raises(PluginError, match=r"bad of bad 1\.0 .* returns int from read"):
        source.read(0, 0, 0)


def test_plugin_name_that_two_packages_offer_is_refused(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install({ENGINES: "bad = bad_parts:Engine"})
    entry_points = f"[{ENGINES}]\nbad = bad_parts:Engine\n"
    write_package(tmp_path / "more", entry_points, "other", "2.0")
    monkeypatch.syspath_prepend(tmp_path / "more")
    entries.cache_clear()
    with pytest.raises(PluginError, match="is offered twice") as caught:
        make_engine(Track(engine="bad"))  # type: ignore[arg-type]
    assert "bad 1.0" in caught.value.message and "other 2.0" in caught.value.message


def test_plugin_layout_with_the_name_of_a_built_in_one_is_refused(install: Install) -> None:
    install({LAYOUTS: "array = bad_parts"})
    assert layouts.layouts()["array"] is layouts.built_in()["array"]
    with pytest.raises(PluginError, match=r"array of bad 1\.0 .* has the name of a built-in one"):
        load(LAYOUTS, "array", layouts.built_in())
    assert "built-in" in plugin_check(LAYOUTS, "array", "bad 1.0").detail


def test_plugin_engine_or_filter_that_fails_is_named(install: Install) -> None:
    engines = {ENGINES: "bad = bad_parts:Engine\nworse = bad_parts:raising"}
    install(engines | {"lfpipe.filters": "bad = bad_parts:raising"})
    track = Track(engine="bad")  # type: ignore[arg-type]
    with pytest.raises(UserError, match=r"bad of bad 1\.0 .* returns int from detect"):
        make_engine(track).detect(np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(UserError, match=r"worse of bad 1\.0 .*SystemExit"):
        make_engine(Track(engine="worse"))  # type: ignore[arg-type]
    with pytest.raises(UserError, match=r"bad of bad 1\.0 .*SystemExit"):
        make_filter(Track(filter="bad"))


def test_plugin_without_a_method_is_refused(install: Install) -> None:
    install({LAYOUTS: "bad = bad_parts:Engine"})
    assert loaded(LAYOUTS, (), {"describe": NoneType}) == {}


def test_plugin_is_named_where_its_name_is_mistyped(install: Install) -> None:
    install({"lfpipe.filters": "newest = bad_parts:raising", DISPLAYS: "count = bad_parts:raising"})
    with pytest.raises(UserError, match=r"one of predictive, .*newest \(did you mean 'newest'"):
        config.load(None, ("track.filter=newset",))
    with pytest.raises(UserError) as error:
        parse_display("cuont:x")
    assert "count:ARGUMENT" in error.value.remedy


FILTER = """
class Filter:
    restarts_after_loss = holds_when_hidden = False
    reset = lambda self: None

    def __init__(self, track, device_latency_s):
        pass

    def update(self, t_ns, measured):
        import numpy as np

        {update}
"""
SCREEN = """
from lfpipe.host.presentation import Presented
from lfpipe.render.display.display import Display, DisplayNotice
from lfpipe.render.display.overlay import Event

class Screen(Display):
    def __init__(self, *_):
        pass

    {method} = lambda *_: {result}
"""


@pytest.mark.parametrize(
    "update",
    [
        "return 1.0, 2.0, 3.0, 4.0",
        "return measured",
        "return measured, [[0, 0]]",
        "return measured, measured, measured",
        "return measured, 'fast'",
        "return measured, np.zeros((3, 2))",
    ],
)
def test_plugin_filter_returns_two_arrays_or_is_named(install: Install, update: str) -> None:
    install({"lfpipe.filters": "bad = bad_parts:Filter"}, head=FILTER.format(update=update))
    eyes = make_filter(Track(filter="bad"))
    with pytest.raises(PluginError, match=r"bad of bad 1\.0 .* returns \w+ from update: "):
        eyes.update(0, np.zeros((2, 2)))


def test_plugin_filter_may_return_lists(install: Install) -> None:
    update = "return [[[1, 2], [3, 4]], measured]"
    install({"lfpipe.filters": "bad = bad_parts:Filter"}, head=FILTER.format(update=update))
    position, velocity = make_filter(Track(filter="bad")).update(0, np.zeros((2, 2)))
    assert position.dtype == np.float64 and position.tolist() == [[1, 2], [3, 4]]
    assert velocity.shape == (2, 2)


@pytest.mark.parametrize(
    ("method", "result", "why"),
    [
        ("events", "3", "not list"),
        ("events", "[3]", "not Event"),
        ("events", "[Event(5)]", "its name: not str"),
        ("presented", "[Presented(1, None, 0)]", "its t_ns: not int"),
        ("notices", "[DisplayNotice(b'x', True)]", "its text: not str"),
        ("shown_px", "(640,)", "1 values instead of 2"),
        ("shown_px", "('a', 'b')", "not int"),
        ("width_mm", "'wide'", "not float or NoneType"),
        ("show", "0.5", "not int"),
    ],
)
def test_plugin_display_is_named_for_each_wrong_result(
    install: Install, method: str, result: str, why: str
) -> None:
    head = SCREEN.format(method=method, result=result)
    install({DISPLAYS: "bad = bad_parts:Screen"}, head=head)
    screen = open_display(Plugin("bad", ""), (64, 48), "", 60.0, lambda: pytest.fail())
    with pytest.raises(PluginError, match=rf"bad of bad 1\.0 .* returns \w+ from {method}: {why}"):
        getattr(screen, method)()


@pytest.mark.parametrize(
    ("engine", "why"),
    [
        ("return Face([[1, 2], [3, 4]], 1.0, (0, 0, 9, 9))", "its eyes_px"),
        ("return Face(np.zeros((2, 3)), 1.0, (0, 0, 9, 9))", "not an array of 2 x 2"),
        ("return Face(np.zeros((2, 2)), 'sure', (0, 0, 9, 9))", "its confidence"),
        ("return Face(np.zeros((2, 2)), 1.0, (0, 0, 9))", "its box_px"),
        ("return Face(np.zeros((2, 2)), 1.0, (0, 0, 9, 9), head_px=np.zeros((2, 3)))", "10 x 3"),
    ],
)
def test_plugin_engine_is_named_for_each_wrong_face(
    install: Install, engine: str, why: str
) -> None:
    head = "import numpy as np\nfrom lfpipe.track.engine import Face\n"
    install({ENGINES: "bad = bad_parts:Engine"}, head=head, engine=engine)
    with pytest.raises(PluginError, match=rf"returns Face from detect: .*{why}"):
        made_engine = make_engine(Track(engine="bad"))  # type: ignore[arg-type]
        made_engine.detect(np.zeros((4, 4, 3), np.uint8))


@pytest.mark.parametrize(
    "wrong",
    [
        {"rows": "1.0"},
        {"files": "('a',)"},
        {"notes": "(1,)"},
        {"max_value": "None"},
        {"missing": "3"},
        {"read": "None"},
    ],
)
def test_plugin_scene_of_wrong_fields_is_skipped(
    install: Install, tmp_path: Path, wrong: dict[str, str]
) -> None:
    ((name, value),) = wrong.items()
    install({LAYOUTS: "bad = bad_parts"}, describe=f"return scene_of(listing, {name}={value})")
    scene = made.write_grid(tmp_path / "png", made.wall(2, 2, 32, 40))
    source = layouts.describe(scene, Scene())
    assert (source.rows, source.cols) == (2, 2) and "bad of bad 1.0" in source.notes[0]


SOURCE = """
import attrs
import numpy as np
from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.spec import SourceKind

class Opened:
    info = SourceInfo({info})

    def read(self, out):
        {read}

    def close(self):
        pass

class Kind(SourceKind):
    form = "bad:"

    @classmethod
    def parse(cls, rest):
        return cls()

    def open(self, camera):
        {open}
"""


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"open": "return 5"}, "has no info"),
        ({"info": "'x', 640, 30.0, True"}, "its size_px: not tuple"),
        ({"read": "return 5"}, "returns int from read"),
        ({"read": "return Frame(1, None, 0)"}, "its t_sensor_ns: not int"),
        ({"read": "raise SystemExit"}, "fails in read"),
    ],
)
def test_plugin_source_is_named_for_each_wrong_result(
    install: Install, wrong: dict[str, str], why: str
) -> None:
    usual = {"info": "'x', (64, 48), 30.0, True", "read": "return None", "open": "return Opened()"}
    install({SOURCES: "bad = bad_parts:Kind"}, head=SOURCE.format(**usual | wrong))
    for make in (parse_source("bad:").open, lambda camera: parse_source("bad:").opener(camera)()):
        with pytest.raises(PluginError, match=rf"bad of bad 1\.0 .*{why}"):
            make(config.Camera()).read(np.zeros((48, 64, 3), np.uint8))
