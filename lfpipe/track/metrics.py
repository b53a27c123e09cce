"""The metrics of the stage `track`."""

from lfpipe.transport.status import Kind, Metric, MetricSet

METRICS = MetricSet(Metric("face", Kind.FLAG, "the newest frame shows a face"))
