"""The metrics of the stage `capture`."""

from lfpipe.sequence.metrics import RECORDING
from lfpipe.transport.metrics import Kind, Metric, MetricSet

METRICS = MetricSet(
    *RECORDING,
    Metric("nominal_mhz", Kind.GAUGE, "frames per 1000 s that the camera agreed to deliver"),
    Metric("covered", Kind.FLAG, "its frames show nothing: a shutter, a cover, or no light at all"),
    Metric("offset_us", Kind.GAUGE, "between the frames of cameras in a row that are shown as one"),
)
