"""The metrics of the stage `render`."""

from lfpipe.render.viewer.presence import ViewerState
from lfpipe.sequence.metrics import RECORDING
from lfpipe.transport.status import Kind, Metric, MetricSet

VIEWER_STATES = tuple(state.word for state in ViewerState)
METRICS = MetricSet(
    *RECORDING,  # of the eyes of the mouse
    Metric("face", Kind.FLAG, "the newest picture was made for a face"),
    Metric("resting", Kind.FLAG, "no refresh needs a picture, because nothing changes"),
    Metric("t_face_ns", Kind.STAMP, "last picture for a face, or the start of the stage"),
    Metric("viewer", Kind.STATE, "the viewer's presence", VIEWER_STATES),
    Metric("gpu", Kind.FLAG, "a GPU draws warped pictures"),
    Metric("planned", Kind.COUNT, "refreshes of a screen that reports its vblanks"),
    Metric("juddered", Kind.COUNT, "of these, those with another picture than planned"),
    Metric("onset_ns", Kind.DURATION, "latency at the onset of a motion"),
    Metric("steady_ns", Kind.DURATION, "how far pictures lag behind a moving head"),
    Metric("live", Kind.COUNT, "pictures of a live scene"),
    Metric("own_disparity", Kind.COUNT, "of these, those with the disparity of their own frame"),
    Metric("views_age", Kind.HISTOGRAM, "from the exposure of a live scene to its picture"),
    Metric("prediction", Kind.HISTOGRAM, "from the sensor stamp to the time of the predicted eyes"),
)
