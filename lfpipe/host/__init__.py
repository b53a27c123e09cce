"""Everything that differs between operating systems, behind plain functions.

Two things have a second form, for systems without Linux's own: wake-ups and cameras. PORTABLE chooses it; LFPIPE_HOST=portable
does so on Linux too, for tests.
"""

import os
import sys

PORTABLE = os.environ.get("LFPIPE_HOST") == "portable" or sys.platform != "linux"
