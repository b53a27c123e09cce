"""lfpipe: a light field you look into, on an ordinary screen."""

import os

__version__ = "0.1.0"

# OpenCV reads these when it is imported. The first is a second limit behind lfpipe.files.picture_header; the second keeps FFmpeg
# from printing a line for every frame of a damaged video.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(240_000_000))
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
