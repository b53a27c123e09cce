"""States of made sessions, and hypothesis strategies for whatever a message can carry."""

from typing import Any

from hypothesis import strategies as st

from lfpipe.config import Config, SceneSummary, SessionOptions, options
from lfpipe.config.session_options import CameraViewer
from lfpipe.supervisor.requests import commands
from lfpipe.supervisor.session_state import SessionState

SCENE = SceneSummary(
    pack="/packs/one",
    name="one",
    rows=3,
    cols=3,
    height_px=640,
    width_px=640,
    method="warp",
    has_disparity=True,
    scores={"warp": 40.0, "nearest": 30.0},
)

VIEWER = CameraViewer(source="demo", rate_hz=30.0, jpeg_px=(64, 48))


def made_state(**more: Any) -> SessionState:
    usual: dict[str, Any] = {"scene": SCENE, "viewer": VIEWER}
    return SessionState.first(Config(), SessionOptions(**usual | more))


texts = st.text(max_size=20) | st.sampled_from(
    ["", "\0", "/", "/tmp/\udcff", "a" * 5000, "\x1b[2J", *options()]
)
leaves = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=True, allow_infinity=True)
    | texts
)
values = st.recursive(
    leaves,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=12,
)
keys = (
    st.sampled_from(
        [*options(), *(key.split(".")[0] for key in options()), "", ".", "render.", "a.b.c"]
    )
    | texts
)
fields = st.fixed_dictionaries(
    {},
    optional={
        "set": st.dictionaries(keys, values, max_size=5) | values,
        "scene": values,
        "path": values,
        "lease_s": values,
        "eyes": values,
        "start": values,
        "stop": values,
        "section": st.sampled_from(["render", "camera", ""]) | values,
        "values": st.dictionaries(texts, leaves, max_size=3) | values,
        "depth": st.sampled_from(["yes", "asked"]) | values,
        "folder": values,
    },
)
messages = st.builds(
    lambda cmd, more: {"v": 2, **more, "cmd": cmd}, st.sampled_from(commands()) | values, fields
)
