"""Limits of inputs from outside; docs/limits.md states them, and a test compares the two.

Each is far above what real recordings need, and low enough that an input within all of them is read in seconds and in
less than 2 GiB of memory.
"""

MAX_NAME_LENGTH = 200
"""Letters of a path that a message shows."""

MAX_JSON_DEPTH = 64
"""Objects and lists inside one another in a JSON document."""

MAX_TRANSCRIPT_BYTES = 16 << 20
"""Bytes of a transcript or of a plain text; a TextGrid of an hour with every phone, in UTF-16, is smaller."""

MAX_TRANSCRIPT_LINES = 1_000_000
"""Lines of a transcript."""

MAX_SUBTITLE_LETTERS = 3 << 20
"""Letters of a file of subtitles; an hour with the times of all words has about a million."""

MAX_CUE_LINES = 200
"""Lines of one subtitle."""

MAX_WORDS = 100_000
"""Words of a transcript; an hour of fast speech has 12,000."""

MAX_JOINT_MAP_BYTES = 1 << 16
"""Bytes of a joint map."""

MAX_SETTINGS_BYTES = 1 << 18
"""Bytes of the settings of `ha2g data build-video`."""

MAX_CONFIG_BYTES = 1 << 20
"""Bytes of a config file."""

MAX_SETTING = 1_000_000_000
"""Size of any number in a config."""

MAX_SIZE = 10_000
"""Size of any part of a network in a config, such as channels or layers."""

MAX_BVH_HEADER = 8 << 20
"""Letters before the numbers of a BVH file."""

MAX_BVH_LINES = 100_000
"""Lines before the numbers of a BVH file."""

MAX_BVH_JOINTS = 1_000
"""Joints of a BVH file."""

MAX_JOINT_NAME = 200
"""Letters in the name of a joint."""

MAX_JOINT_CHANNELS = 6
"""Channels of a joint of a BVH file."""

MAX_BVH_FRAMES = 2_000_000
"""Frames of a BVH file; two hours at 240 frames per second have 1,728,000."""

MAX_BVH_VALUES = 30_000_000
"""Numbers of the motion of a BVH file, frames times channels."""

MAX_SMPLX_FRAMES = 400_000
"""Frames of an SMPL-X file, more than an hour at 100 frames per second."""

MAX_POSED_JOINTS = 6_000_000
"""Joints of an imported motion times its frames at the new rate; 50 joints have 5,400,000 in an hour at 30 a second."""

MIN_FILE_FPS = 0.1
"""Least frames per second of an imported motion file."""

MAX_FILE_FPS = 1_000
"""Most frames per second of an imported motion file."""
