"""`python -m tests.camera_vm`: the tests of this folder in a virtual machine with a real camera
driver.
"""

import argparse
import shlex
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import platformdirs

from tests.camera_vm import machine


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-k", default="", help="as pytest's")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the machine is ended, too
    out = Path(tempfile.mkdtemp(prefix="lfpipe-vm-"))
    try:
        machine.install_tools()
        kernel = machine.prepare(platformdirs.user_cache_path("lfpipe-vm"))
        words = [
            *(sys.executable, "-m", "pytest", "tests/camera_vm", "-m", "camera_vm", "-v", "-n0"),
            *("-p", "no:cacheprovider", "--timeout=90", "--junitxml=/guest/junit.xml"),
            *(("-k", arguments.k) if arguments.k else ()),
        ]
        env = ("LFPIPE_GUEST=1", "PYTHONUNBUFFERED=1", f"PYTHONPATH={Path.cwd()}")
        command = " ".join([*env, shlex.join(words)])
        code, output = machine.run(kernel, command, out, 900.0)
    except machine.UnavailableError as error:
        print(f"camera tests in a virtual machine: not run: {error}")
        return 3
    finally:
        shutil.rmtree(out, ignore_errors=True)
    print(output)
    print(f"kernel {kernel.version}, exit code {code}")
    return code


if __name__ == "__main__":
    sys.exit(main())
