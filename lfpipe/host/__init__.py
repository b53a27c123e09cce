"""Everything that differs between operating systems, behind plain functions.

PORTABLE chooses cameras without Video4Linux; LFPIPE_HOST=portable does so on Linux too, for tests.
"""

import os
import sys

PORTABLE = os.environ.get("LFPIPE_HOST") == "portable" or sys.platform != "linux"
