"""These tests run only in the guest; each begins without a camera."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.camera_vm import driver

collect_ignore_glob = [] if os.environ.get("LFPIPE_GUEST") else ["test_*.py"]


@pytest.fixture
def vivid() -> Iterator[Path]:
    """A vivid webcam that was just plugged in."""
    driver.unload("vivid")
    yield driver.plug()
    driver.unload("vivid")
