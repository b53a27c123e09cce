from pathlib import Path

import pytest

from lfpipe import config


@pytest.fixture
def scene_config(tmp_path: Path) -> config.Scene:
    """Scene settings with a cache of the test's own."""
    return config.Scene(cache_dir=str(tmp_path / "cache"))
