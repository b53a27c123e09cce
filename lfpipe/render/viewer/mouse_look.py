"""The mouse as the viewer: without a camera, and with one while the right button is held.

The pointer position in the window maps to the eye position in front of the view grid: at the left
edge, the eyes see the leftmost view, at the top the topmost. The wheel sets the distance, dragging
moves the neutral position, and the eyes follow as smoothly as a head.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config
from lfpipe.config.camera_pose import camera_focal_px
from lfpipe.eyes import Eyes, EyesRecord, low_pass_gain
from lfpipe.render.display.display import Pointer
from lfpipe.render.viewer.geometry import SEAT_MM
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.sequence.packets import eyes_line
from lfpipe.sequence.recorder import Recordable, Recorder
from lfpipe.transport.context import RingOutput
from lfpipe.transport.ring import SECOND_NS, Stamp

EASE_S = 0.06  # time constant of two cascaded low-passes: mouse motion becomes like head motion
NEAR_MM, FAR_MM = 250.0, 4000.0  # range of the wheel, from reading distance to across a room
# of the wheel, and of key +: hardly visible at once, twice the parallax in seven steps
STEP = 1.1


class MouseLook:
    """Makes eyes records from the pointer.

    ring: "eyes", which it writes in a session without a camera; None with a camera.
    """

    def __init__(self, config: Config, viewer: Viewer, ring: RingOutput | None) -> None:
        self._viewer, self._pointer = viewer, Pointer()
        self._size_px = config.camera.frame_px
        self._anchor = 0.5, 0.5  # where the pointer must be for the neutral position
        # distance of the eyes in the picture, px, times that of the viewer, mm
        self._eyes_px_mm = camera_focal_px(config, self._size_px[0]) * config.screen.eyes_mm
        distance_mm = config.screen.distance_mm
        self._distance_mm = SEAT_MM if distance_mm == "auto" else float(distance_mm)
        # the middle of the eyes after one low-pass, and after both
        self._eased_px: tuple[NDArray[np.float64], ...] | None = None
        self._t_ns = self._released_ns = 0
        self._count = 0
        self.ring = ring
        """Which it writes; None while it writes none."""
        self.recorder: Recorder | None = None
        """Records the eyes of a viewer that is the mouse."""
        self._alone = ring is not None

    def exchange(self, alone: bool) -> None:
        """alone: whether the mouse is the viewer from now on."""
        self.ring = None
        self._alone = alone
        self._eased_px = None

    @property
    def is_viewer(self) -> bool:
        """Whether the mouse is the viewer now."""
        return self._alone or self._pointer.right or self._eased_px is not None

    def move(self, pointer: Pointer, t_ns: int) -> None:
        """Processes the pointer's state at t_ns."""
        before, self._pointer = self._pointer, pointer
        if pointer.left and before.left and self.is_viewer:
            self._anchor = (
                self._anchor[0] + pointer.x - before.x,
                self._anchor[1] + pointer.y - before.y,
            )
        if pointer.wheel and self.is_viewer:
            self._distance_mm = min(max(self._distance_mm * STEP**-pointer.wheel, NEAR_MM), FAR_MM)
        if before.right and not pointer.right:
            self._released_ns = t_ns

    def recentre(self) -> bool:
        """Makes the pointer position neutral; returns whether the mouse is the viewer."""
        if self._alone:
            self._anchor = self._pointer.x, self._pointer.y
        return self._alone

    def eyes(
        self, record: EyesRecord | None, stamp: Stamp | None, t_ns: int
    ) -> tuple[EyesRecord, Stamp]:
        """The record and stamp of the eyes at t_ns.

        record, stamp: of the camera, if there is one.
        """
        solver, field = self._viewer.solver, self._viewer.field
        face = record if record is not None and record.face else None
        centre_px = (
            np.array(self._size_px) / 2.0
            if solver is None or self._alone
            else np.array(solver.centre_px)
        )
        start_px = centre_px if face is None else np.reshape(face.filtered_px, (2, 2)).mean(axis=0)
        target_px = centre_px
        if not self._alone and not self._pointer.right:
            target_px = start_px
        elif solver is not None:
            x, y = self._pointer.x - self._anchor[0], self._pointer.y - self._anchor[1]
            steps = -x * max(field.cols - 1, 1), y * max(field.rows - 1, 1)
            # a viewer who moves right is further left in the camera's picture
            target_px = centre_px + solver.alpha_px * np.array(steps)
        if self._eased_px is None:
            self._eased_px = (start_px, start_px)
            self._t_ns = t_ns
        share = low_pass_gain(max(t_ns - self._t_ns, 0) / 1e9, EASE_S)
        self._t_ns = t_ns
        once_px = self._eased_px[0] + (target_px - self._eased_px[0]) * share
        middle_px = self._eased_px[1] + (once_px - self._eased_px[1]) * share
        self._eased_px = once_px, middle_px

        eye_distance_px = self._eyes_px_mm / self._distance_mm
        if face is not None:
            eye_distance_px = face.eye_distance_px or math.dist(
                face.filtered_px[:2], face.filtered_px[2:]
            )
        mouse_eyes = EyesRecord(
            _eye_distance(target_px, eye_distance_px),
            _eye_distance(middle_px, eye_distance_px),
            (0.0, 0.0, 0.0, 0.0),
            eye_distance_px,
            1.0,
            *self._size_px,
            t_ns,
            1,
            record.generation if record is not None else 0,
        )
        if self._alone or stamp is None:
            self._count += 1
            stamp = Stamp(self._count, self._count, 0, t_ns, t_ns, t_ns, 0)
        if self.ring is not None:
            written = self.ring.begin()
            mouse_eyes.write(written)
            self.ring.publish(self._count, t_ns, t_ns, 0, 0)
            if self.recorder is not None and self.recorder.active:
                self.recorder.add(
                    Recordable(
                        source_seq=self._count,
                        epoch=0,
                        t_sensor_ns=t_ns,
                        t_read_ns=t_ns,
                        codec="eyes",
                        data=eyes_line(written, source_seq=self._count),
                    )
                )
        if not (self._alone or self._pointer.right) and t_ns - self._released_ns > SECOND_NS // 2:
            self._eased_px = None  # the camera's eyes again: after 8 EASE_S, no step is visible
        return mouse_eyes, stamp


def _eye_distance(middle_px: NDArray[np.float64], eye_distance_px: float) -> Eyes:
    x, y = middle_px.tolist()
    return x + eye_distance_px / 2, y, x - eye_distance_px / 2, y
