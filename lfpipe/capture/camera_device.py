"""A camera as the system lists it, and the modules for cameras on this machine."""

from importlib import import_module
from pathlib import Path
from typing import Any

import attrs

from lfpipe.host.camera_interface import LIST, SOURCE


@attrs.frozen
class CameraDevice:
    """A listed device. name: the driver's. bus: its path in /sys. Both empty if unknown."""

    path: Path
    name: str
    bus: str = ""


def known() -> Any:
    """Has `nodes`, `cameras`, `describe` and `asking` of `camera_list`."""
    return import_module(f"lfpipe.capture.{LIST}")


def source() -> Any:
    """Has `CameraFinder`, `first_camera`, `open_camera` and `check_camera` of `camera`."""
    return import_module(f"lfpipe.capture.{SOURCE}")
