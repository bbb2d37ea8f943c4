"""Opening of files of sound and images with FFmpeg."""

import pathlib
from typing import Any

import av
from av.container import InputContainer
from av.error import FFmpegError

from ha2g_jax.limits import MAX_VIDEO_PIXELS

# FFmpeg knows hundreds of formats, among them lists of other files and of addresses in the network, which a file of
# unknown origin must not make it open, and pictures of letters, which any text is. These are those of recordings.
FORMATS = (
    *("3g2", "3gp", "aac", "ac3", "aiff", "amr", "amrnb", "amrwb", "ape", "asf", "au", "avi", "caf", "dsf", "dts"),
    *("dtshd", "dv", "eac3", "flac", "flv", "gsm", "gxf", "h264", "hevc", "ivf", "loas", "m4v", "matroska", "mlp"),
    *("mov", "mp3", "mp4", "mpc", "mpc8", "mpeg", "mpegts", "mpegvideo", "mxf", "nut", "obu", "ogg", "rm", "tak"),
    *("truehd", "tta", "voc", "w64", "wav", "webm", "wtv", "wv"),
)
MEDIA_ERRORS = (FFmpegError, OSError, ValueError, ArithmeticError, LookupError)
"""Exceptions by which PyAV answers damaged files."""
MAX_PACKET_VALUES = 1 << 23
"""Samples of all channels that a packet may decode to, four times as many as the longest of a real codec."""

_OPTIONS = {
    "format_whitelist": ",".join(FORMATS),
    # For the codecs that look into the beginning of a file while it is opened.
    "max_pixels": str(MAX_VIDEO_PIXELS),
    "max_samples": str(MAX_PACKET_VALUES),
}
# Tags may have letters in any encoding. PyAV accepts them since version 19; before, it fails unless it is told.
_TAGS: Any = {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "replace"}


def open_media(path: pathlib.Path) -> InputContainer:
    """Open a file of sound or images, which the caller must close.

    Args:
        path: path of the file, with any characters.

    Raises:
        One of `MEDIA_ERRORS`: the file cannot be read, or is no recording.
    """
    # Without "file:" the part of a name before a colon would be taken for a protocol.
    return av.open(f"file:{path}", options=_OPTIONS, **_TAGS)
