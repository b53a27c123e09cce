"""Refusals of engines and their networks."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from lfpipe.track.engine import MediapipeEngine
from lfpipe.track.network import Network, model_file
from tests.test_messages import Cause

DETECTION = "modules/face_detection/face_detection_short_range.tflite"


def broken(here: Path) -> None:
    (here / "face.tflite").write_bytes(b"no network at all")
    Network(here / "face.tflite", 192, (1404, 1))


def newer(_: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "mediapipe", SimpleNamespace(__version__="0.10.35"))
        MediapipeEngine()


MESSAGES: dict[str, tuple[Cause, str]] = {
    "a broken network": (
        broken,
        "track.engine = litert: /here/face.tflite: not a usable face network … lfpipe models get",
    ),
    "a network of another version": (
        lambda _: Network(model_file(DETECTION), 192, (1404, 1)),
        "track.engine = litert: … another version: input (1, 128, 128, 3) … lfpipe models get",
    ),
    "a version without FaceMesh": (newer, "track.engine = mediapipe: … no FaceMesh … 0.10.21"),
}
