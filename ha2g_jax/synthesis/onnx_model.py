"""A trained model in an ONNX file that generates motion from speech with ONNX Runtime, without JAX."""

import concurrent.futures
import contextlib
import dataclasses
import hashlib
import importlib.resources
import json
import os
import pathlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ha2g_jax.checkpoint import ASSETS, CONFIG, WEIGHTS, hub
from ha2g_jax.checkpoint.assets import Assets, shortest_decimals
from ha2g_jax.checkpoint.onnx.reading import BY, FEATURES, OUTPUT, SUFFIX, Description, read, to_metadata
from ha2g_jax.data.speech import prepare, window
from ha2g_jax.errors import UserError, require
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.noise import track
from ha2g_jax.features.text import Word
from ha2g_jax.files.cache import cache_folder, one_maker
from ha2g_jax.files.reading import read_json, reason, shown
from ha2g_jax.files.writing import write_text
from ha2g_jax.limits import MAX_ASSETS_BYTES
from ha2g_jax.motion.cues import describe_catalogue
from ha2g_jax.motion.resample import num_frames
from ha2g_jax.motion.windows import num_windows
from ha2g_jax.progress import progress_bar
from ha2g_jax.synthesis.generator import Generator
from ha2g_jax.synthesis.style import RANDOM, Style, choose_style

if TYPE_CHECKING:
    import onnxruntime

_MOST_THREADS = 4  # threads of the encoder; with more it would be faster than the sampler, which has one thread

NUM_SEEDS = 100

_TEXTS = ("format", "name", "method", "hash", "license", "weights")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class OnnxModel(Generator[Description]):
    """A trained generator that computes with ONNX Runtime, see `load_onnx`.

    Attributes:
        spec: sizes of the model.
        assets: skeleton, styles of the training speakers, and calm seed poses.
        encoder: network from "mel" to the audio features.
        sampler: network from the audio features, "style", "seed_pose" and, if the model has noise, "noise" to "poses".
        path: name of the file, for messages.
    """

    spec: Description  # pyrefly: ignore[bad-override]
    assets: Assets  # pyrefly: ignore[bad-override]
    encoder: "onnxruntime.InferenceSession"
    sampler: "onnxruntime.InferenceSession"
    path: str

    @property
    def name(self) -> str:
        return self.spec.name

    @property
    def reads_words(self) -> bool:
        """Whether the words of the speech change the motion; HA2G does not read them."""
        return False

    def choose_style(self, style: Style, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
        return choose_style(self.spec, {}, self.assets, style, seed)

    def sample_windows(
        self, audio: np.ndarray, words: Sequence[Word], style: np.ndarray, seed_pose: np.ndarray, seed: int
    ) -> np.ndarray:
        """Sample the poses of all windows of speech, see `Generator.sample_windows`.

        The speech of later windows is encoded in a separate thread while a window is sampled.
        """
        del words
        spec, overlap, stride = self.spec, self.spec.num_seed_frames, self.spec.window_stride
        count = num_windows(num_frames(len(audio) / SAMPLE_RATE, self.fps), spec.num_frames, stride)
        speech = prepare(audio, (), ("mel",))

        def encode(index: int) -> list[np.ndarray]:
            first = index * stride
            inputs = window(speech, ("mel",), self.assets.vocabulary, first, spec.num_frames, self.fps)
            return self._run(self.encoder, FEATURES, {"mel": inputs["mel"][None]})

        poses, seed_pose = [], np.asarray(seed_pose, np.float32)[None]
        inputs = {"style": np.asarray(style, np.float32)[None]}
        ahead = concurrent.futures.ThreadPoolExecutor(1)
        try:
            with progress_bar("generating", count, "window", is_part=True) as bar:
                for index, found in enumerate(ahead.map(encode, range(count))):
                    inputs |= {"seed_pose": seed_pose, **dict(zip(FEATURES, found, strict=True))}
                    if spec.noise_dim:
                        frames = index * stride + np.arange(spec.num_frames)
                        inputs["noise"] = track(seed, frames, self.fps, spec.noise_dim)[None]
                    (sampled,) = self._run(self.sampler, [OUTPUT], inputs)
                    poses.append(sampled[0])
                    seed_pose = sampled[:, stride : stride + overlap]
                    bar.update()
        finally:
            ahead.shutdown(cancel_futures=True)
        return np.stack(poses)

    def _run(
        self, session: "onnxruntime.InferenceSession", outputs: Sequence[str], inputs: dict[str, np.ndarray]
    ) -> list[np.ndarray]:
        with _blame(self.path):
            return [np.asarray(it) for it in session.run(list(outputs), inputs)]


def load_onnx(path: str | pathlib.Path) -> OnnxModel:
    """Load a model from a file of `ha2g model onnx`.

    Raises:
        UserError: there is no such file, it is damaged or of another kind, or the extra onnx is not installed.
    """
    require("onnxruntime", "onnx", by=BY)
    import onnxruntime

    description, parts = read(path)
    with _blame(shown(path)):
        sessions = []
        for part, threads in ((parts.encoder, _encoder_threads()), (parts.sampler, 1)):
            options = onnxruntime.SessionOptions()
            options.log_severity_level = 4  # an exception says the same
            options.intra_op_num_threads = threads
            options.enable_mem_pattern = False  # it takes up to twice the memory
            # Threads that wait for work do not take a core from the other part, or from other programs.
            options.add_session_config_entry("session.intra_op.allow_spinning", "0")
            # Weights of int8 become float32 once and not in each window.
            options.add_session_config_entry("session.disable_quant_qdq", "1")
            settings = {"providers": ["CPUExecutionProvider"], "enable_fallback": 0}  # a second try prints to stdout
            sessions.append(onnxruntime.InferenceSession(part, options, **settings))
    return OnnxModel(description, description.assets, *sessions, path=shown(path))


def exported(checkpoint: str | pathlib.Path) -> pathlib.Path:
    """Return the ONNX file of a model in the cache folder, and write it if it does not exist.

    Args:
        checkpoint: "demo", a model folder, or a model on the Hub.

    Raises:
        UserError: there is no model folder, the model cannot be exported, or the cache folder cannot be written.
    """
    folder = hub.fetch(str(checkpoint)) if hub.is_hub_name(checkpoint) else pathlib.Path(checkpoint)
    if checkpoint == "demo":
        folder = pathlib.Path(str(importlib.resources.files("ha2g_jax") / "assets" / "demo"))
    assets, config = folder / ASSETS, folder / CONFIG
    if not all(path.is_file() for path in (assets, config, folder / WEIGHTS)):
        raise UserError(
            f"no model folder at {shown(checkpoint)}; write an ONNX file with ha2g model onnx, and give it as "
            "--checkpoint"
        )
    found = read_json(assets, "the assets of a model", MAX_ASSETS_BYTES)
    name = found.get("hash") if isinstance(found, dict) else None
    if not (isinstance(name, str) and name.isalnum() and name.isascii() and len(name) <= 64):
        raise UserError(f"{shown(assets)} has no hash of the weights; export or download the model again")
    # The file also depends on the assets, the config and the version of the exporter, which may change while the
    # weights do not.
    sources = importlib.resources.files("ha2g_jax") / "checkpoint" / "onnx"
    exporter = [sources / f"{part}.py" for part in ("export", "networks", "reading")]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in (assets, config, *exporter))).hexdigest()[:16]
    path = cache_folder() / "onnx" / f"{name}-{digest}{SUFFIX}"
    if not path.is_file():
        with one_maker(path):
            if not path.is_file():
                for package in ("onnx", "onnxruntime"):
                    require(package, "onnx", by=BY)
                from ha2g_jax.checkpoint.onnx.export import export

                export(checkpoint if checkpoint == "demo" else folder, path)
    return path


def _encoder_threads() -> int:
    return max(1, min((os.cpu_count() or 1) - 1, _MOST_THREADS))


@contextlib.contextmanager
def _blame(path: str) -> Iterator[None]:
    """Turn the exceptions of ONNX Runtime into a `UserError`; they have no class in common."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    kinds = (state.Fail, state.InvalidArgument, state.InvalidGraph, state.InvalidProtobuf, state.RuntimeException)
    try:
        yield
    except (*kinds, state.NotImplemented, ValueError) as error:
        raise UserError(f"{path} cannot be used ({reason(error)}); export the model again") from error


def write_page_description(path: str | pathlib.Path) -> pathlib.Path:
    """Write `page_description` of an ONNX file as model.json beside it, and return its path.

    Raises:
        UserError: see `checkpoint.onnx.reading.read`, or the file cannot be written.
    """
    out = pathlib.Path(path).with_name("model.json")
    write_text(out, json.dumps(page_description(path), separators=(",", ":")))
    return out


def page_description(path: str | pathlib.Path, seeds: int = NUM_SEEDS) -> dict[str, Any]:
    """Return what a web page needs in addition to an ONNX file, the contents of its model.json.

    They are the values of the file's metadata by name (docs/onnx.md); "takes" of some seeds from 0 on, see `takes`; and
    "limbs" and "cues", see `describe_catalogue`.

    Raises:
        UserError: see `checkpoint.onnx.reading.read`.
    """
    description, _ = read(path)
    metadata = to_metadata(description)
    values = {name: text if name in _TEXTS else json.loads(text) for name, text in metadata.items()}
    catalogue = describe_catalogue(description.assets.skeleton)
    return values | {"takes": takes(description, seeds)} | catalogue


def takes(description: Description, seeds: int = NUM_SEEDS) -> list[dict[str, Any]]:
    """Return the random choices of `Generator.generate` for each seed from 0 on, for a runtime without NumPy.

    Returns:
        For each seed "style", the values of the random style; "variation", the values added to the style of a speaker
        or a mixture with a variation of 1; and "seed_pose", the index of the seed pose.
    """
    zero = np.zeros(description.style_dim, np.float32)
    no_style = dataclasses.replace(description.assets, speakers={"": zero})
    found = []
    for seed in range(seeds):
        style, _ = choose_style(description, {}, description.assets, RANDOM, seed)
        variation, _ = choose_style(description, {}, no_style, Style(speaker="", variation=1.0), seed)
        seed_pose = description.assets.choose_seed_pose(seed)
        found.append(
            {"style": shortest_decimals(style), "variation": shortest_decimals(variation), "seed_pose": seed_pose}
        )
    return found
