"""lfpipe: a light field you look into, on an ordinary screen."""

import os

__version__ = "0.1.0"

# OpenCV reads these when it is first imported and used. The first is a second limit behind lfpipe.picture_header, for claims
# that were overlooked there; the second keeps FFmpeg from printing what it thinks of every frame of a damaged video.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(240_000_000))
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
