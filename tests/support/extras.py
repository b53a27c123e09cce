"""Whether lfpipe/extras is there: without it, the tests of the core pass."""

import importlib.util

import pytest

PRESENT = importlib.util.find_spec("lfpipe.extras") is not None
with_extras = pytest.mark.skipif(not PRESENT, reason="without lfpipe/extras")
