"""The bytes of messages between processes, and the keys of answers and metrics in their order.

`tests/contracts/wire_format.json` holds them as maps, in the order of their keys.
"""

import json
from pathlib import Path
from typing import Any

from lfpipe.plugins import REQUESTS, plugins
from lfpipe.plugins import STAGES as PLUGGED_STAGES
from tests.contracts import contract
from tests.support.world import World, answer_of, connected

WIRE: dict[str, Any] = contract("wire_format.json")
EXACT = ("ok", "cmd", "error", "remedy", "v", "topic")


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
