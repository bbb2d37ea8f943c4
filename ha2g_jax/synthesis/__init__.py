"""Generate motion from speech of any length with a trained model."""

import importlib
from typing import TYPE_CHECKING, Any

from ha2g_jax.synthesis.generator import Audio, Generator, read_speech
from ha2g_jax.synthesis.style import Style, choose_style, read_mixture

if TYPE_CHECKING:
    from ha2g_jax.synthesis.model import Model, encode_features, generate_directions, load
    from ha2g_jax.synthesis.onnx_model import OnnxModel, load_onnx
    from ha2g_jax.synthesis.stream import Stream

__all__ = [
    "Audio",
    "Generator",
    "Model",
    "OnnxModel",
    "Stream",
    "Style",
    "choose_style",
    "encode_features",
    "generate_directions",
    "load",
    "load_onnx",
    "read_mixture",
    "read_speech",
]

_MODULES = {"Stream": "stream", "OnnxModel": "onnx_model", "load_onnx": "onnx_model"}
_MODULES |= dict.fromkeys(("Model", "encode_features", "generate_directions", "load"), "model")


def __getattr__(name: str) -> Any:
    # Imported on first use, so that an ONNX file generates motion without JAX, and a folder without ONNX Runtime.
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
