"""Conditions of results besides the code: versions of the packages that compute them, and the machine."""

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import cv2

from lfpipe import __version__

OPENCV = "opencv-contrib-python-headless"
PACKAGES = ("numpy", OPENCV, "mediapipe", "ai-edge-litert")


def processor() -> str:
    """Name of the processor: networks and numpy choose their code by it, and round differently."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def versions() -> dict[str, str]:
    """Name -> version of lfpipe, Python, the packages that compute, and the processor."""
    found = {"lfpipe": __version__, "python": platform.python_version(), "machine": platform.machine(), "processor": processor()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = cv2.__version__ if name == OPENCV else "none"  # another of the four packages that provide cv2
    return found
