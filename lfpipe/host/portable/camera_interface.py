"""The modules of `lfpipe.capture` that list and read cameras: OpenCV's, which supports AVFoundation and Media Foundation."""

LIST = SOURCE = "opencv_camera"
