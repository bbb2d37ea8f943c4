"""Old names of settings, which stored configs, config files and flags may still use.

Every use of an old name is answered by a line that has the new one.
"""

import copy
import sys
from collections.abc import Sequence
from typing import Any

# Old name -> new name; {method} is the method of the config, {audio} the kind of its audio encoder.
RENAMED = {
    "data.num_reference_frames": "data.num_reference_images",
    "model.audio.blocks": "model.audio.resnet_se.blocks",
    "model.audio.channels": "model.audio.{audio}.channels",
    "model.audio.stem_stride": "model.audio.resnet_se.stem_stride",
    "model.identity.width": "model.identity.images.width",
    "loss.weights": "loss.{method}.weights",
    "loss.gan": "loss.{method}.gan",
    "loss.huber_delta": "loss.{method}.huber_delta",
    "loss.temperature": "loss.{method}.temperature",
    "loss.negatives": "loss.{method}.negatives",
    "loss.style_clip": "loss.{method}.style_clip",
}

# Settings that configs of a method once held without reading them; they are left out.
_UNREAD = {
    "seq2seq": ("gan", "huber_delta", "temperature", "negatives", "style_clip"),
    "speech2gesture": ("huber_delta", "temperature", "negatives", "style_clip"),
    "joint_embedding": ("gan", "huber_delta", "temperature", "negatives", "style_clip"),
    "trimodal": ("temperature", "negatives"),
    "autoencoder": ("gan", "huber_delta", "temperature", "negatives", "style_clip"),
}
_AUDIO_KINDS = {
    "seq2seq": "none",
    "speech2gesture": "spectrogram",
    "joint_embedding": "waveform",
    "trimodal": "waveform",
    "autoencoder": "none",
}


def new_name(name: str, method: str) -> str:
    """Return the present name of a setting, such as "loss.ha2g.weights.gan" for "loss.weights.gan".

    Args:
        name: dotted name, old or present.
        method: name of the method of the config.
    """
    for old, new in RENAMED.items():
        if name == old or name.startswith(f"{old}."):
            audio = _AUDIO_KINDS.get(method, "resnet_se")
            return new.format(method=method, audio=audio) + name.removeprefix(old)
    return name


def with_new_names(values: dict[str, Any]) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Return stored settings under their present names, and (old, new) of each that was renamed.

    Args:
        values: nested settings as plain values; left as they are.
    """
    values, renamed = copy.deepcopy(values), []
    if values.get("method") == "speech2gesture_legacy":
        values["method"] = "speech2gesture"
        values["model"]["legacy"] = True
        renamed.append(("method=speech2gesture_legacy", "model.legacy=True"))
    method = values.get("method", "ha2g")
    # Settings that are younger than the method, at the values that stand for what it was before.
    if method == "speech2gesture":
        values["model"].setdefault("legacy", False)
    if method == "ha2g":
        values["model"].setdefault("inferer", {}).setdefault("seed_level", "below")
    for old in RENAMED:
        *path, last = old.split(".")
        part = _part(values, path)
        if part is None or last not in part:
            continue
        value, new = part.pop(last), new_name(old, method)
        if path == ["loss"] and last in _UNREAD.get(method, ()):
            continue
        if path == ["model", "audio"] and method in _AUDIO_KINDS:
            part["kind"] = _AUDIO_KINDS[method]
            if (method, last) != ("speech2gesture", "channels"):
                continue
        *path, last = new.split(".")
        part = values
        for name in path:
            part = part.setdefault(name, {})
        part[last] = value
        renamed.append((old, new))
    if "ha2g" in values.get("loss", {}):
        values["loss"]["ha2g"].setdefault("version", 1)
    return values, renamed


def warn(renamed: Sequence[tuple[str, str]], where: str) -> None:
    """Print one line on stderr that names the old settings found and their present names; none where there are none.

    Args:
        renamed: (old, new) of each setting.
        where: name of the file or command that uses them.
    """
    if renamed:
        pairs = ", ".join(f"{old} is now {new}" for old, new in renamed)
        sys.stderr.write(f"ha2g: {where} uses old names of settings: {pairs}\n")


def _part(values: dict[str, Any], path: Sequence[str]) -> dict[str, Any] | None:
    for name in path:
        values = values.get(name, {})
        if not isinstance(values, dict):
            return None
    return values
