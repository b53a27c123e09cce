"""Reads shared eyes and marks a stimulus on the same clock.

Usage: python lsl_experiment.py NAME, beside `lfpipe up SCENE --share lsl:NAME`
"""

import sys

try:
    import pylsl
except ImportError:
    sys.exit("pylsl is missing: pip install 'lfpipe[share]'")

if len(sys.argv) != 2:
    sys.exit(__doc__)

found = pylsl.resolve_byprop("name", f"{sys.argv[1]}-eyes", minimum=1, timeout=10)
if not found:
    sys.exit(f"no stream {sys.argv[1]}-eyes within 10 s: is the session running?")
eyes = pylsl.StreamInlet(found[0], max_buflen=2)
marks = pylsl.StreamOutlet(
    pylsl.StreamInfo("answers", "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, "answers-1")
)
correction_s = eyes.time_correction()  # 0 on one machine, measured between two


def show_stimulus() -> None:
    """With PsychoPy: draw, `window.callOnFlip(marks.push_sample, ["stimulus"])`, and flip."""
    marks.push_sample(["stimulus"], pylsl.local_clock())


show_stimulus()
for _ in range(10):
    sample, t_s = eyes.pull_sample(timeout=5)
    if sample is None:
        sys.exit("no eyes for 5 s: is the session running?")
    left_x, left_y, left_z = sample[:3]  # mm; NaN without a face
    age_ms = 1000 * (pylsl.local_clock() - t_s - correction_s)
    print(f"{left_x:7.1f} {left_y:7.1f} {left_z:7.1f} mm, {age_ms:5.1f} ms old")
