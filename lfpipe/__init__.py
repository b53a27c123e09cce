"""lfpipe: a light field you look into, on an ordinary screen."""

import os

__version__ = "0.1.0"

# OpenCV reads it when it is first imported. A second limit behind lfpipe.picture_header, for claims that were overlooked there.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(240_000_000))
