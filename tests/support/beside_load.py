"""Runs the default suite beside eight busy loops, three times.

`python -m tests.support.beside_load [PYTEST ARGUMENTS]`.

Ends with 1 if any run fails: a test that waits for time and not for events shows itself here.
"""

import subprocess
import sys
import time

LOOPS, RUNS = 8, 3


def main() -> int:
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(LOOPS)]
    codes = []
    try:
        for number in range(1, RUNS + 1):
            began_s = time.monotonic()
            codes.append(subprocess.run([sys.executable, "-m", "pytest", *sys.argv[1:]]).returncode)
            print(
                f"run {number} of {RUNS}: exit code {codes[-1]} after"
                f" {time.monotonic() - began_s:.0f} s",
                flush=True,
            )
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    return int(any(codes))


if __name__ == "__main__":
    sys.exit(main())
