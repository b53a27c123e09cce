"""Runs commands without the powers of root, which may enter every folder and read every file."""

import os
import shutil

import pytest

# Also with another user's id, most of a suite that runs as root could not be reached: its interpreter is in root's own folder.
DROP_POWERS = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"]


@pytest.fixture(scope="session")
def as_nobody() -> list[str]:
    """What a command begins with, so that permissions count for it as they do for everybody."""
    if os.getuid():
        return []
    if shutil.which(DROP_POWERS[0]) is None:
        pytest.skip("setpriv is not installed (apt-get install util-linux), and permissions do not apply to root")
    return DROP_POWERS
