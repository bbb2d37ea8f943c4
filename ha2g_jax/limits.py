"""Limits of inputs from outside; docs/limits.md states them, and a test compares the two.

Each is far above what real recordings need, and low enough that an input within all of them is read in seconds and in
less than 2 GiB of memory.
"""

MAX_NAME_LENGTH = 200
"""Letters of a path that a message shows."""

MAX_JSON_DEPTH = 64
"""Objects and lists inside one another in a JSON document."""

MAX_CONFIG_BYTES = 65_536
"""Size of the config.json of a model folder, a workdir or a Whisper model."""

MAX_ASSETS_BYTES = 33_554_432
"""Size of the assets.json of a model folder or a workdir."""

MAX_HEADER_BYTES = 4_194_304
"""Size of the header of a file of safetensors, which names its tensors."""

MAX_WEIGHTS_BYTES = 671_088_640
"""Size of the model.safetensors of a model folder, and of the encoder of a Whisper model in 16 bits."""

MAX_VOCABULARY = 1_000_000
"""Words of a model."""

MAX_SPEAKERS = 10_000
"""Speakers of a model."""

MAX_START_POSES = 1_000
"""Start poses of a model."""

MAX_WINDOW_FRAMES = 68
"""Frames of a window of a model."""

MAX_REFERENCE_IMAGES = 16
"""Reference images of a training example."""

MAX_IMAGE_SIZE = 1_024
"""Pixels of the side of a reference image as a network takes it."""

MAX_LAYERS = 12
"""Layers of a recurrent network, blocks of a stage of the audio network, and stages of the spectrogram's network."""

MAX_TEXT_LAYERS = 10
"""Layers of the text network, each of which sees twice as far as the one before."""

MAX_WHISPER_LAYERS = 32
"""Layers of a Whisper encoder."""

MAX_CHANNELS = 8_192
"""Channels of a layer, and values of a state, a feature, a word vector or a style."""

MAX_RECORD_BYTES = 33_554_432
"""Size of run.json, and of each file of a checkpoint but those of its arrays."""

MAX_METRICS_LINE = 1_048_576
"""Letters of a line of metrics.jsonl."""

MAX_STYLE_PIXELS = 50_000_000
"""Pixels of a reference image of `ha2g generate --reference-image`."""

MAX_SEED = 2**63 - 1
"""Seed of random choices."""

MAX_TALK_MINUTES = 100_000
"""Minutes of speech of a Talk corpus."""

MAX_TALK_SPEAKERS = 10_000
"""Speakers of a Talk corpus."""
