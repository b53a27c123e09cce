"""A child process that reads a complete video before anything relies on it: `python -m lfpipe.scene.video_probe PATH`.

A container's claims about its frames may differ from its stream, and only decoding shows that. It happens here, where running out
of memory, a crash or a hang does no harm. Prints a line of JSON with width, height and rate, a dot for every frame and, at the
end of the video, a line "end".
"""

import json
import sys

import cv2

from lfpipe.host.limits import limit_memory

OPENING_BYTES = 200_000_000  # memory limit of a decoder before the frame size is known
FRAME_BYTES_PX = 20  # memory limit per pixel afterwards; measured: 6 to 15 with FFV1, MPEG-4, VP9
MAX_FRAME_PX = 22_000_000  # 9x9 views of 512x512; OpenCV holds a frame three times
MAX_FRAMES = 1_000_000


def open_video(path: str, frame_px: int) -> cv2.VideoCapture:
    """Opens a video for decoding by FFmpeg; large frames on one thread, because each thread holds its own frames."""
    return cv2.VideoCapture(path, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 2 if frame_px <= 12_000_000 else 1])


def main(path: str) -> None:
    """Reads the video at path; trusts neither path nor content."""
    limit_memory(OPENING_BYTES)
    capture = open_video(path, MAX_FRAME_PX)
    if not capture.isOpened():
        return
    width, height = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    print(json.dumps({"width_px": width, "height_px": height, "rate_hz": capture.get(cv2.CAP_PROP_FPS)}), flush=True)
    if not 0 < width * height <= MAX_FRAME_PX:
        return
    limit_memory(max(OPENING_BYTES, FRAME_BYTES_PX * width * height))
    capture.release()
    capture = open_video(path, width * height)
    for _ in range(MAX_FRAMES):
        if not capture.grab():
            print("\nend")
            return
        print(".", end="", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
