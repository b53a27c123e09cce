"""The bytes of messages between processes, and the keys of answers and metrics in their order.

`tests/contracts/wire_format.json` holds them as maps, in the order of their keys.
"""

import json
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from lfpipe.plugins import REQUESTS, plugins
from lfpipe.plugins import STAGES as PLUGGED_STAGES
from lfpipe.supervisor import metrics
from lfpipe.supervisor.process_table import METRICS, STAGES
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.histogram import Histogram
from lfpipe.transport.status import ROW, SESSION, Row, State
from tests.contracts import contract
from tests.support.world import World, answer_of, connected

WIRE: dict[str, Any] = contract("wire_format.json")
EXACT = ("ok", "cmd", "error", "remedy", "v", "topic")
T_NS = 100 * SECOND_NS


def shape(value: Any, key: str = "") -> Any:
    """The keys of a message in their order, and the types of its values."""
    if isinstance(value, dict) and key != "config":  # whose keys `docs/configuration.md` lists
        return {name: shape(inner, name) for name, inner in value.items()}
    return value if key in EXACT else type(value).__name__


def of_core(value: Any, key: str = "") -> Any:
    """A message without the stages and commands of other packages."""
    if isinstance(value, dict):
        others = plugins(PLUGGED_STAGES) if key == "stages" else ()
        return {name: of_core(inner, name) for name, inner in value.items() if name not in others}
    if isinstance(value, list):
        return [of_core(inner) for inner in value]
    if key == "error":
        for name in plugins(REQUESTS):
            value = value.replace(f", {name}", "")
    return value


def assert_same(name: str, message: Any) -> None:
    """In the order of the keys, too."""
    assert json.dumps(of_core(message)) == json.dumps(WIRE[name]), name


def _row(name: str, **values: object) -> np.ndarray[Any, Any]:
    row = np.zeros((), ROW)
    row["name"] = name
    for field, value in values.items():
        row[field] = value
    return row


def test_wire_format_of_metrics(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (metrics, "lfpipe.transport.status", "lfpipe.notices"):
        monkeypatch.setattr(f"{getattr(module, '__name__', module)}.now_ns", lambda: T_NS)
    monkeypatch.setattr(metrics, "usable_cores", lambda pid: [0, 1])
    rows = {stage.name: _row(stage.name) for stage in STAGES}
    for name in ("capture", "track", "render"):
        rows[name] = _row(name, pid=7, state=State.RUNNING, seq=9, drops=1, busy_ns=4)
        rows[name]["recent_ns"][:3] = T_NS - np.array([2, 1, 0]) * SECOND_NS // 30
        for histogram in ("wait", "busy", "age"):
            for ms in (1, 2, 30):
                Histogram(rows[name][histogram]).add_ns(ms * 1_000_000)
    own = {name: Row(row, METRICS[name]) for name, row in rows.items()}
    for ms in (1, 2, 30):
        own["render"].histograms["prediction"].add_ns(ms * 1_000_000)
    own["track"]["face"] = own["render"]["face"] = 1
    own["capture"]["nominal_mhz"] = 30_000
    rows["track"]["busy_with"] = b"fetching"
    rows["track"]["busy_since_ns"] = T_NS - 3 * SECOND_NS
    for key, value in {"planned": 400, "juddered": 3, "viewer": 2, "onset_ns": 61_200_000}.items():
        own["render"][key] = value
    session = np.zeros((), SESSION)
    made = metrics.session_metrics("one", rows, METRICS, session, T_NS - 5 * SECOND_NS)
    assert_same("metrics", made.to_dict())
    session["level"], session["lowest"], session["words"] = 1, 4, b"nearest views"
    own["render"]["planned"] = own["render"]["onset_ns"] = 0
    made = metrics.session_metrics("one", rows, METRICS, session, T_NS - 5 * SECOND_NS)
    watched = attrs.evolve(made.stages["track"], cpu_percent=12.5, rss_mb=80.0)
    made = attrs.evolve(made, stages={"track": watched})
    assert_same("metrics at a lower level, watched", made.to_dict())


def test_wire_format_of_a_session(world: World, scene: Path, tmp_path: Path) -> None:
    world.shows(scene, "--set=governor.quality=fixed")
    # The scores of a scene come with its disparity, after its first pictures.
    world.wait_for(lambda: world.ask(cmd="hello")["options"]["scene"]["complete"], "disparity")
    pairs = WIRE["requests and answers of a session"]
    places = {"SCENE": str(scene), "TRACE": str(tmp_path / "t.jsonl")}
    *requests, stop = [
        {key: places.get(value, value) if isinstance(value, str) else value for key, value in asked}
        for asked in (pair["request"].items() for pair in pairs)
    ]
    with connected(world.session_dir) as socket, world.tap() as heard:
        answers = [shape(answer_of(socket, message)) for message in requests]
        world.wait_for(lambda: heard("look"), "eyes of a picture")
        looked = shape(heard("look")[0])
        printed = world.ctl("--json", "status"), world.ctl("--json", "pause")
        metrics_json = world.done("monitor", "--session", world.name, "--once", "--json").stdout
        answers.append(shape(answer_of(socket, stop)))
    assert json.dumps(of_core(answers)) == json.dumps([pair["answer"] for pair in pairs])
    (look,) = [one for one in contract("tap.json") if one["topic"] == "look"]
    assert looked == shape({"v": 2, **look})
    assert_same("ctl --json", [shape(json.loads(text)) for text in printed])
    assert_same("monitor --json", shape(json.loads(metrics_json)))
