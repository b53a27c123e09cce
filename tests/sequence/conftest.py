"""An intact sequence of six frames, with eyes and truth."""

from pathlib import Path

import pytest

from tests.support import hostile_sequences


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hostile_sequences.made_sequence(tmp_path_factory.mktemp("sequences") / "whole")
