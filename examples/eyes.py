"""Prints where the eyes are in a video.

Usage: python eyes.py VIDEO
"""

import sys

import cv2

import lfpipe

if len(sys.argv) != 2:
    sys.exit(__doc__)

video = cv2.VideoCapture(sys.argv[1])
rate_hz = video.get(cv2.CAP_PROP_FPS) or 30.0
with lfpipe.Tracker() as tracker:
    number = 0
    while (taken := video.read())[0]:
        eyes = tracker.update(taken[1], t_ns=round(number * 1e9 / rate_hz))
        if eyes is not None and eyes.head is not None and number % 15 == 0:
            x, y, z = eyes.head.position_mm
            print(f"{number / rate_hz:5.1f} s: {x:6.0f} {y:6.0f} {z:6.0f} mm")
        number += 1
