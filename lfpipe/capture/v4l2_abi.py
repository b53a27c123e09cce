"""The structures and request numbers of linux/videodev2.h in use here: a stable binary interface.

linuxpy (formerly v4l2py) wraps the whole interface, but its licence, GPL 3 or later, does not suit
an Apache-2.0 program.
"""

import ctypes
from ctypes import Structure, Union, c_char, c_int32, c_long, c_uint8, c_uint32, c_ulong, sizeof
from typing import Any

# V4L2_CAP_VIDEO_CAPTURE and _STREAMING
CAP_CAPTURES, CAP_MULTI_PLANAR, CAP_DEVICE_CAPS = 0x04000001, 0x1000, 0x80000000
# V4L2_BUF_TYPE_VIDEO_CAPTURE, V4L2_FRMSIZE_TYPE_DISCRETE and so on
VIDEO_CAPTURE = MEMORY_MMAP = DISCRETE = 1
BUF_FLAG_ERROR, STAMP_SOURCE_MASK, STAMP_SOURCE_SOE = 0x40, 0x70000, 0x10000
FIELD_NONE = 1
CTRL_DISABLED, CTRL_READ_ONLY = 0x1, 0x4
# V4L2_IN_ST_NO_POWER, _NO_SIGNAL, _NO_H_LOCK: what such an input delivers is noise
INPUT_WITHOUT_SIGNAL = 0x103


def _words(*names: str) -> tuple[tuple[str, Any], ...]:
    return tuple((name, c_uint32) for name in names)


class Capability(Structure):
    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        *_words("version", "capabilities", "device_caps", "reserved0", "reserved1", "reserved2"),
    )


class FormatDescription(Structure):
    _fields_ = (
        *_words("index", "type", "flags"),
        ("description", c_char * 32),
        *_words("pixelformat", "mbus_code"),
        ("reserved", c_uint32 * 3),
    )


class FrameSize(Structure):
    """sizes: of a discrete one width and height, of a range least, most and step of each."""

    _fields_ = (
        *_words("index", "pixelformat", "type"),
        ("sizes", c_uint32 * 6),
        ("reserved", c_uint32 * 2),
    )


class FrameInterval(Structure):
    """interval: numerator and denominator in seconds, of a range the shortest first."""

    _fields_ = (
        *_words("index", "pixelformat", "width", "height", "type"),
        ("interval", c_uint32 * 6),
        ("reserved", c_uint32 * 2),
    )


class PixelFormat(Structure):
    _fields_ = (
        *_words("width", "height", "pixelformat", "field", "bytesperline", "sizeimage"),
        *_words("colorspace", "priv", "flags", "ycbcr_enc", "quantization", "xfer_func"),
    )


class _FormatUnion(Union):
    _fields_ = (("pix", PixelFormat), ("raw", c_uint8 * 200), ("align", ctypes.c_void_p))


class Format(Structure):
    _fields_ = (("type", c_uint32), ("fmt", _FormatUnion))


class StreamParameters(Structure):
    """interval: numerator and denominator of the time per frame in seconds."""

    _fields_ = (
        *_words("type", "capability", "mode"),
        ("interval", c_uint32 * 2),
        ("rest", c_uint8 * 184),
    )


class Input(Structure):
    _fields_ = (
        ("index", c_uint32),
        ("name", c_char * 32),
        *_words("type", "audioset", "tuner"),
        ("std", ctypes.c_uint64),
        *_words("status", "capabilities"),
        ("reserved", c_uint32 * 3),
    )


class Number(Structure):
    """A whole number: of an input, or a buffer's type."""

    _fields_ = (("value", c_int32),)


class RequestBuffers(Structure):
    _fields_ = _words("count", "type", "memory", "capabilities", "flags")


class TimeValue(Structure):
    _fields_ = (("seconds", c_long), ("microseconds", c_long))


class Buffer(Structure):
    _fields_ = (
        *_words("index", "type", "bytesused", "flags", "field"),
        ("timestamp", TimeValue),
        ("timecode", c_uint32 * 4),
        *_words("sequence", "memory"),
        ("offset", c_ulong),
        *_words("length", "reserved"),
        ("request_fd", c_int32),
    )


class QueryControl(Structure):
    _fields_ = (
        *_words("id", "type"),
        ("name", c_char * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("default", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


class Control(Structure):
    _fields_ = (("id", c_uint32), ("value", c_int32))


def _request(direction: int, number: int, argument: Any) -> int:
    return direction << 30 | sizeof(argument) << 16 | ord("V") << 8 | number


_WRITE, _READ = 1, 2
QUERYCAP = _request(_READ, 0, Capability)
ENUM_FMT = _request(_READ | _WRITE, 2, FormatDescription)
S_FMT = _request(_READ | _WRITE, 5, Format)
REQBUFS = _request(_READ | _WRITE, 8, RequestBuffers)
QUERYBUF = _request(_READ | _WRITE, 9, Buffer)
QBUF = _request(_READ | _WRITE, 15, Buffer)
DQBUF = _request(_READ | _WRITE, 17, Buffer)
STREAMON = _request(_WRITE, 18, c_int32)
STREAMOFF = _request(_WRITE, 19, c_int32)
S_PARM = _request(_READ | _WRITE, 22, StreamParameters)
ENUMINPUT = _request(_READ | _WRITE, 26, Input)
G_CTRL = _request(_READ | _WRITE, 27, Control)
S_CTRL = _request(_READ | _WRITE, 28, Control)
QUERYCTRL = _request(_READ | _WRITE, 36, QueryControl)
G_INPUT = _request(_READ, 38, Number)
ENUM_FRAMESIZES = _request(_READ | _WRITE, 74, FrameSize)
ENUM_FRAMEINTERVALS = _request(_READ | _WRITE, 75, FrameInterval)


def fourcc_text(code: int) -> str:
    """The four characters of a pixel format."""
    return code.to_bytes(4, "little").decode("ascii", "replace").strip()


def fourcc_code(text: str) -> int:
    """The inverse of `fourcc_text`, for formats of ASCII characters."""
    return int.from_bytes(text.ljust(4).encode("ascii", "replace"), "little")
