"""Limits of inputs from outside, see docs/limits.md: within all of them an input takes seconds and less than 2 GiB."""

MAX_NAME_LENGTH = 200
"""Characters of a path that a message shows."""

MAX_JSON_DEPTH = 64
"""Depth of nested objects and lists in a JSON document."""

MAX_CONFIG_BYTES = 65_536
"""Size of the config.json of a model folder, a workdir or a Whisper model."""

MAX_ASSETS_BYTES = 33_554_432
"""Size of the assets.json of a model folder or a workdir."""

MAX_HEADER_BYTES = 4_194_304
"""Size of the header of a file of safetensors, which names its tensors."""

MAX_WEIGHTS_BYTES = 1 << 30
"""Size of the model.safetensors of a model folder; released weights with six tables of 40,000 words take 0.7 GB."""

MAX_WHISPER_BYTES = 671_088_640
"""Size of the encoder of a Whisper model in 16 bits; that of Whisper medium takes 614 MB."""

MAX_CARD_BYTES = 1_048_576
"""Size of a text that becomes part of a model card."""

MAX_ONNX_BYTES = 200 << 20
"""Size of an ONNX file; the size of the paper takes 157 MB in float32."""

MAX_ONNX_GRAPH_BYTES = 1 << 20
"""Bytes of an ONNX file beside weights and metadata; the size of the paper takes 65 kB."""

MAX_ONNX_METADATA_BYTES = 20 << 20
"""Letters of the metadata of an ONNX file; the demo has 119,000."""

MAX_ONNX_MEMORY = 1_050_000_000
"""Bytes that an ONNX file may take, those of its weights four times; the size of the paper has 1,045 million for
windows of 68 frames."""

MAX_ONNX_PRODUCTS = 14_000_000_000
"""Multiplications of an ONNX file for a window; the size of the paper has 13 thousand million for 68 frames."""

MAX_TORCH_BYTES = 1 << 31
"""Size of an archive of weights of PyTorch, which is mapped and not read; the state of an optimiser triples it."""

MAX_TORCH_PICKLE_BYTES = 1 << 28
"""Size of the pickle in an archive of PyTorch, which may have the word vectors of a vocabulary."""

MAX_TORCH_OPCODES = 5_000_000
"""Opcodes of the pickle in an archive of PyTorch; three make an entry of a vocabulary."""

MAX_TORCH_FILES = 8_000
"""Files in an archive of PyTorch, one for each tensor."""

MAX_VOCABULARY = 1_000_000
"""Words of a model."""

MAX_SPEAKERS = 10_000
"""Speakers of a model."""

MAX_SEED_POSES = 1_000
"""Seed poses of a model."""

MAX_WINDOW_FRAMES = 68
"""Frames of a window of a model."""

MAX_REFERENCE_IMAGES = 16
"""Reference images of a training example."""

MAX_IMAGE_SIZE = 1_024
"""Pixels of the side of a reference image at the input of a network."""

MAX_LAYERS = 12
"""Layers of a recurrent network, blocks of a stage of the audio network, and stages of the spectrogram's network."""

MAX_TEXT_LAYERS = 10
"""Layers of the text network, each of which sees twice as far as the previous one."""

MAX_WHISPER_LAYERS = 32
"""Layers of a Whisper encoder."""

MAX_CHANNELS = 8_192
"""Channels of a layer, and values of a state, a feature, a word vector or a style."""

MAX_RECORD_BYTES = 33_554_432
"""Size of run.json, and of each file of a checkpoint except those of its arrays."""

MAX_TALK_SPEAKERS = 10_000
"""Speakers of a Talk corpus."""

MAX_TALK_MINUTES = 100_000
"""Minutes of a Talk corpus."""

MAX_MOTION_FRAMES = 1_000_000
"""Frames of a motion, and of all motions of a page; an hour at 240 frames per second has 864,000."""

MAX_MOTION_SECONDS = 7_800
"""Seconds of a motion: twice the longest sound."""

MIN_MOTION_FPS = 0.1
"""Lowest frame rate of a file of motion."""

MAX_MOTION_FPS = 1_000
"""Highest frame rate of a file of motion."""

MIN_FPS = 1
"""Lowest frame rate of generated motion, and of a corpus."""

MAX_FPS = 240
"""Highest frame rate of generated motion, and of a corpus."""

MIN_MODEL_FPS = 15
"""Lowest frame rate of a model, for which features and networks can be derived."""

MAX_MODEL_FPS = 30
"""Highest frame rate of a model, for the same reason."""

MIN_WINDOW_FRAMES = 17
"""Least number of frames in a window of a model, for the same reason."""

MAX_MOTION_JOINTS = 1_000
"""Joints of a file of motion from another system, such as BVH or glTF."""

MAX_MOTION_BYTES = 1 << 30
"""Bytes of the unpacked arrays of a file of motion, and of a glTF file."""

MAX_MOTION_META_BYTES = 1 << 20
"""Bytes of the JSON text `meta` of a file of motion."""

MAX_MOTION_JSON_BYTES = 1 << 25
"""Bytes of a file of motion in JSON, and of the JSON text of a glTF file."""

MAX_SOUND_SECONDS = 3900.0
"""Seconds of a recording: an hour and five minutes."""

MIN_SOUND_RATE = 1_000
"""Lowest sample rate of a recording."""

MAX_SOUND_RATE = 768_000
"""Highest sample rate of a recording, that of the fastest audio interfaces."""

MAX_SOUND_CHANNELS = 64
"""Channels of a recording."""

MAX_SOUND_VALUES = 375_000_000
"""Samples of a recording, times its channels or 2 if it is mono: 65 minutes in stereo at 48 kHz."""

MAX_VIDEO_PIXELS = 33_177_600
"""Pixels of an image of a video: 7680 x 4320."""

MAX_VIDEO_IMAGE_BYTES = 53_084_160
"""Bytes of a decoded image of a video, of which codecs keep up to 16: 7680 x 4320 has 49,766,400 in 8 bits."""

MAX_VIDEO_IMAGES = 468_000
"""Images of a video: 65 minutes at 120 images per second."""

MAX_PICTURE_BYTES = 268_435_456
"""Bytes of a reference image."""

MAX_PICTURE_PIXELS = 67_108_864
"""Pixels of a reference image, such as 8192 x 8192."""

MAX_PICTURE_PASSES = 805_306_368
"""Pixels of a reference image in progressive JPEG, times its passes over them, usually 10."""

MAX_NPZ_RATIO = 200
"""Bytes that a byte of any `.npz` may unpack to: recordings unpack to three, zip bombs to 1,000."""

MAX_NPZ_OF_ANY_RATIO = 1 << 28
"""Bytes of unpacked arrays up to which a `.npz` may be compressed by any factor, as an array of zeros is."""

MAX_UNPACKED_RATIO = 100
"""Bytes that a byte of packed word vectors may unpack to; text of numbers unpacks to three."""

MAX_SEED = 2**32 - 1
"""Seed of random choices."""

MAX_TRANSCRIPT_BYTES = 16 << 20
"""Bytes of a transcript or of a plain text; a TextGrid of an hour with every phone, in UTF-16, is smaller."""

MAX_TRANSCRIPT_LINES = 1_000_000
"""Lines of a transcript."""

MAX_SUBTITLE_LETTERS = 3 << 20
"""Letters of a file of subtitles; an hour with the times of all words has about a million."""

MAX_WORDS = 100_000
"""Words of a transcript; an hour of fast speech has 12,000."""

MAX_JOINT_MAP_BYTES = 1 << 16
"""Bytes of a joint map."""

MAX_SETTINGS_BYTES = 1 << 18
"""Bytes of the settings of `ha2g data build-video`."""

MAX_PROGRAM_BYTES = 1 << 20
"""Bytes of a config that is a Python program."""

MAX_SETTING = 1_000_000_000
"""Size of any number in a config."""

MAX_BVH_HEADER = 8 << 20
"""Letters before the numbers of a BVH file."""

MAX_BVH_LINES = 100_000
"""Lines before the numbers of a BVH file."""

MAX_JOINT_NAME = 200
"""Letters in the name of a joint."""

MAX_JOINT_CHANNELS = 6
"""Channels of a joint of a BVH file."""

MAX_BVH_FRAMES = 2_000_000
"""Frames of a BVH file; two hours at 240 frames per second have 1,728,000."""

MAX_BVH_VALUES = 30_000_000
"""Numbers of the motion of a BVH or glTF file or of a table, frames times channels."""

MAX_SMPLX_FRAMES = 400_000
"""Frames of an SMPL-X file, more than an hour at 100 frames per second."""

MAX_POSED_JOINTS = 6_000_000
"""Joints of an imported motion times its frames at the new rate; 50 joints have 5,400,000 in an hour at 30 a second."""

MAX_FACE_VALUES = 400
"""Values of a face in a frame: weights of expressions; FLAME has 100."""

MAX_ANSWER_BYTES = 1 << 20
"""Bytes of the answers of a participant in a user study; an item takes about 200."""

MAX_ANSWER_FILES = 10_000
"""Answer files that are analysed together."""
