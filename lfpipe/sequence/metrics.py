"""The metrics of the stages that record."""

from lfpipe.transport.status import Kind, Metric

RECORDING = (
    Metric("recorded", Kind.COUNT, "frames stored by recordings"),
    Metric("unrecorded", Kind.COUNT, "frames that recordings missed"),
)
