"""Files of valid structure with wrong values, of every kind that is read: each opens or is refused;
none prints a traceback or leaves a file.

`pytest tests/scene/test_wrong_values.py --hypothesis-profile=explore` tries new ones;
`python -m tests.support.wrong_values 10000` so many, with what came of them.
"""

import json
import random
import subprocess
import sys
import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from tests.support import wrong_values


@settings(max_examples=1)
@given(seed=st.integers(0, 2**32))
def test_wrong_values_open_or_are_refused(seed: int) -> None:
    command = [sys.executable, "-m", "tests.support.wrong_values", "40", "--seed", str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stdout + done.stderr
    assert sum(json.loads(done.stdout)["found"].values()) == 40


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32))
def test_numbers_in_names_open_or_are_refused(seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = wrong_values.names(random.Random(seed), Path(folder))
        try:
            layouts.describe(path, config.Scene())
        except UserError as error:
            assert str(folder) in str(error) and error.remedy
