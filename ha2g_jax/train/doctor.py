"""Check everything that a run needs before it starts: the machine, the config, the data, and one step."""

import collections
import contextlib
import os
import pathlib
import platform
from typing import Any, NamedTuple

import jax

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config
from ha2g_jax.data.corpus import TALK, TRAIN, Corpus, corpus_folder
from ha2g_jax.errors import UserError
from ha2g_jax.features import espeak
from ha2g_jax.features.espeak import Voice
from ha2g_jax.layers.cpu.onednn.library import used_version
from ha2g_jax.methods import build
from ha2g_jax.progress import counted, stage, track
from ha2g_jax.train import inputs
from ha2g_jax.train.fits import check_augmentation, check_machine
from ha2g_jax.train.measure import TimedStep, gib
from ha2g_jax.train.run_record import host_memory, installed

_STEPS = 5
_SECONDS = 20.0  # no further step is timed after this time
_LESS_MEMORY = "lower --config.train.batch_size or, for HA2G, raise --config.train.accumulate"

_PACKAGES = ("ha2g-jax", "jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "grain", "numpy")
_CUDA_PLUGINS = ("jax-cuda12-plugin", "jax-cuda13-plugin")
# Files by which JAX itself detects a GPU: those of a driver, of a container and of WSL.
_GPU_FILES = ("/dev/nvidia0", "/dev/nvidiactl", "/dev/dxg")


class Finding(NamedTuple):
    """Result of one check: what was found, in words and as values; what is wrong and how to mend it, "" if nothing."""

    name: str
    found: str
    trouble: str = ""
    values: dict[str, Any] | None = None


def examine(config: Config | None = None) -> list[Finding]:
    """Check the machine, check that it has what a config needs, and time a step, which takes a minute or more.

    Without a config the step is that of the smallest model, and no data are checked.
    """
    findings = [*examine_machine(), _espeak()]
    if not next(it for it in findings if it.name == "devices").found:  # without devices, nothing can be computed
        return findings
    corpus = None
    if config is None:
        config = presets.sized("ted_expressive", "debug")
        findings.append(Finding("data", "not checked; name a config with --config FILE[:SIZE]"))
    else:
        settings, (data, corpus) = _settings(config), _data(config)
        findings += [settings, *data, _word_vectors(config)]
        if settings.trouble:
            return findings
    return [*findings, _step(config, corpus)]


def as_text(findings: list[Finding]) -> str:
    """Format findings as one line each: "ok" and the finding, or "wrong" and what to do."""
    width = max(len(finding.name) for finding in findings)
    lines = [
        f"{'wrong' if finding.trouble else 'ok':5}  {finding.name:{width}}  "
        + "; ".join(filter(None, (finding.found, finding.trouble)))
        for finding in findings
    ]
    return "\n".join(lines)


def as_json(findings: list[Finding]) -> dict[str, Any]:
    """Return the findings as plain values, with "ok" true if no check found a problem."""
    rows = [finding._asdict() | {"ok": not finding.trouble} for finding in findings]
    return {"ok": is_well(findings), "findings": rows}


def is_well(findings: list[Finding]) -> bool:
    """Return whether no check found a problem."""
    return not any(finding.trouble for finding in findings)


def examine_machine() -> list[Finding]:
    """Check Python and packages, devices, cores and memory."""
    return [_python(), _packages(), _devices(), _host()]


def _python() -> Finding:
    values = {"python": platform.python_version(), "platform": platform.platform()}
    return Finding("python", f"{values['python']} on {values['platform']}", values=values)


def _packages() -> Finding:
    versions: dict[str, str | None] = dict.fromkeys(_PACKAGES) | installed(_PACKAGES)
    missing = " ".join(name for name, version in versions.items() if version is None)
    with contextlib.suppress(RuntimeError):  # JAX finds no device, which `_devices` reports
        if onednn := used_version():
            versions["onednn"] = onednn
    found = ", ".join(f"{name} {version}" for name, version in versions.items() if version is not None)
    return Finding("packages", found, f"pip install {missing}" if missing else "", versions)


def _devices() -> Finding:
    try:
        devices = jax.devices()
    except RuntimeError as error:  # JAX_PLATFORMS names a platform that is not available
        return Finding("devices", "", f"JAX finds none ({str(error).splitlines()[0]}): unset JAX_PLATFORMS")
    kinds = collections.Counter(device.device_kind for device in devices)
    memory = {device.device_kind: (device.memory_stats() or {}).get("bytes_limit") for device in jax.local_devices()}
    found = [
        f"{count} x {kind}" + (f" with {gib(size)} each for JAX" if (size := memory.get(kind)) else "")
        for kind, count in kinds.items()
    ]
    values = {"devices": dict(kinds), "device_memory": memory, "backend": jax.default_backend()}
    return Finding("devices", ", ".join(found), _idle_gpu(), values)


def _idle_gpu() -> str:
    """Return why JAX does not use the GPU of this machine, "" if it does or if there is none."""
    if jax.default_backend() != "cpu" or not any(map(os.path.exists, _GPU_FILES)):
        return ""
    if platforms := os.environ.get("JAX_PLATFORMS"):
        return f"there is an NVIDIA GPU, but JAX_PLATFORMS={platforms} keeps JAX from using it: unset JAX_PLATFORMS"
    if plugins := list(installed(_CUDA_PLUGINS)):
        return (
            f"there is an NVIDIA GPU, but {plugins[0]} does not start: "
            "JAX_PLATFORMS=cuda python -c 'import jax; jax.devices()' shows why"
        )
    return (
        "there is an NVIDIA GPU, but JAX computes on the CPU: pip install -U 'jax[cuda13]', "
        "or 'jax[cuda12]' where the driver is older than 580"
    )


def _host() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    total, available = host_memory()
    found = f"{cores} cores" + (f", {gib(total)} of memory" if total else "")
    found += f", {gib(available)} available" if available is not None else ""
    return Finding("machine", found, values={"cores": cores, "memory": total, "memory_available": available})


def _espeak() -> Finding:
    try:
        espeak.say("hello", Voice("en-us", "m1", 50, 50, 170))
    except UserError as error:
        return Finding("speech", "", str(error))
    return Finding("speech", "espeak-ng speaks, for the Talk corpus")


def _settings(config: Config) -> Finding:
    train = config.train
    found = f"{config.name} on {config.skeleton}, batches of {train.batch_size} in {train.dtype}, {train.steps} steps"
    try:
        check_machine(config)
    except UserError as error:
        return Finding("config", found, str(error))
    return Finding("config", found)


def _word_vectors(config: Config) -> Finding:
    path = config.model.text.vectors
    if path and not pathlib.Path(path).is_file():
        return Finding("words", "", f"no word vectors at {path}: set --config.model.text.vectors to a file, or to ''")
    return Finding("words", f"vectors of {path}" if path else "random vectors to start from")


def _data(config: Config) -> tuple[list[Finding], Corpus | None]:
    """Return the findings on the corpus and each of its splits, and the corpus if it can be opened."""
    folder = corpus_folder(config.data.path)
    if config.data.path == TALK and not folder.exists():
        return [Finding("data", f"the Talk corpus is not made yet; training will make it in {folder}")], None
    try:
        corpus = inputs.open_corpus(config)
    except UserError as error:
        return [Finding("data", "", str(error))], None
    whole = Finding("data", f"{corpus.path}, {corpus.skeleton.name} at {corpus.fps:g} fps")
    return [whole, *(_split(config, corpus, split) for split in corpus.splits)], corpus


def _split(config: Config, corpus: Corpus, split: str) -> Finding:
    """Read every record of a split, and decode the first and the last clip."""
    values: dict[str, Any] = {"split": split, "speakers": len(corpus.speakers_of(split))}
    try:
        clips = corpus.clips(split)
        numbers = track(range(len(clips)), f"checking the split {split}", "clip")
        frames = sum(len(clips.fields(number)["positions"]) for number in numbers)
        _ = clips[:1], clips[-1:]
        values |= {"clips": len(clips), "hours": frames / corpus.fps / 3600}
        if len(clips) and split in (TRAIN, inputs.VALIDATION):
            vocabulary = corpus.vocabulary()
            spec = build(config, corpus.skeleton, len(vocabulary), len(corpus.speakers_of(TRAIN)))
            if split == TRAIN:
                check_augmentation(config, spec)
                inputs.pretrained(config, spec, vocabulary)
                values["windows"] = len(inputs.open_windows(config, spec, corpus, split))
            elif windows := inputs.open_validation(config, spec, corpus):
                values["windows"] = len(windows)
    except UserError as error:
        return Finding("data", split, str(error), values)
    counts = [counted(values[f"{noun}s"], noun) for noun in ("clip", "window", "speaker") if f"{noun}s" in values]
    found = f"{split}: {values['hours']:.2f} hours, {', '.join(counts)}"
    if split == TRAIN and values.get("windows", config.train.batch_size) < config.train.batch_size:
        trouble = f"fewer windows than a batch of {config.train.batch_size}: lower --config.train.batch_size"
        return Finding("data", found, trouble, values)
    return Finding("data", found, values=values)


def _step(config: Config, corpus: Corpus | None) -> Finding:
    values: dict[str, Any] = {}
    found = ""
    try:
        with stage("compiling the training step, which takes minutes on a CPU"):
            step = TimedStep(config, corpus)
        values = {"compile_seconds": step.compile_seconds, "devices": step.num_devices, "batch_size": step.batch_size}
        found = f"compiled in {step.compile_seconds:.1f} s"
        if step.memory is not None:
            values |= {"memory": step.memory._asdict() | {"total": step.memory.total}}
            found += f", needs {gib(step.memory.total)}" + (" on each device" if step.num_devices > 1 else "")
            if trouble := _lack_of_memory(step.memory.total, step.num_devices):
                return Finding("step", found, trouble, values)
        with stage("measuring the training step"):
            seconds = step.median(_STEPS, _SECONDS)
    except UserError as error:
        return Finding("step", found, str(error), values)
    except jax.errors.JaxRuntimeError as error:
        return Finding("step", found, f"the step fails ({str(error).splitlines()[0]}): {_LESS_MEMORY}", values)
    values |= {"step_seconds": seconds, "windows_per_second": step.batch_size / seconds}
    found += f"; {seconds:.3g} s a step, {step.batch_size / seconds:.3g} windows/s"
    return Finding("step", found, values=values)


def _lack_of_memory(size: int, num_devices: int) -> str:
    """Return what to do if a step of `size` bytes on each device does not fit into memory, "" if it fits."""
    if jax.default_backend() == "cpu":  # the devices of a CPU share the memory of the host
        size, available = size * num_devices, host_memory()[1]
    else:
        stats = [device.memory_stats() or {} for device in jax.local_devices()]
        free = [s["bytes_limit"] - s["bytes_in_use"] for s in stats if {"bytes_limit", "bytes_in_use"} <= s.keys()]
        available = min(free, default=None)
    if available is None or size <= available:
        return ""
    return f"the step needs {gib(size)} but {gib(available)} are available, so it was not run: {_LESS_MEMORY}"
