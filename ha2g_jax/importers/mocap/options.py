"""Options that the importers of all motion capture formats have in common."""

import dataclasses
import os


@dataclasses.dataclass(frozen=True)
class ImportOptions:
    """Options of `import_bvh` and `import_smplx`.

    Attributes:
        skeleton: name of the skeleton, "ted_expressive", or "ted_gesture" for motion without fingers.
        fps: frames per second of the corpus.
        speaker: name of the speaker of all files; by default it is taken from the names of files and folders, see
            `recordings.find_recordings`.
        audio: audio file of the only motion file, in any format of `read_audio`; by default it lies beside the motion.
        words: transcript of the only motion file; by default it lies beside the motion.
        with_words: whether a recording needs a transcript; if not, windows may have no words.
        split: name of the split to write.
        licence: licence of the data, stored in the corpus.
    """

    skeleton: str = "ted_expressive"
    fps: float = 15
    speaker: str | None = None
    audio: str | os.PathLike | None = None
    words: str | os.PathLike | None = None
    with_words: bool = True
    split: str = "train"
    licence: str = ""
