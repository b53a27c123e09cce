"""Which modules of `lfpipe.capture` list and read cameras here: OpenCV's, which knows AVFoundation and Media Foundation."""

LIST = SOURCE = "opencv_camera"
