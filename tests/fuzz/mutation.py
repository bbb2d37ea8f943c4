"""Strategies of Hypothesis that damage valid inputs: bytes, lines of text, trees of JSON, arrays, and whole files."""

import copy
import io
import json
import math
import os
import pathlib
from typing import Any

import numpy as np
from fixtures.glb_reader import join_glb, split_glb
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

# A short run that is always the same in the suite; `make fuzz` sets the number of examples and draws others each time.
FUZZ = settings(
    max_examples=int(os.environ.get("HA2G_FUZZ_EXAMPLES", "25")),
    derandomize="HA2G_FUZZ_EXAMPLES" not in os.environ,
    database=None,
    deadline=None,
    suppress_health_check=(
        HealthCheck.too_slow,
        HealthCheck.data_too_large,
        HealthCheck.filter_too_much,
        HealthCheck.large_base_example,
        HealthCheck.function_scoped_fixture,
    ),
    print_blob=True,
)

# Integers at which counts, sizes and offsets go wrong.
_ODD_INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1)
_ODD_NUMBERS = ("0", "-1", "1e-300", "1e300", "nan", "inf", "-inf", "999999999999999999999", "0x10", "", "1e", "0.1.2")
_ODD_VALUES = (
    None, True, 0, -1, 10**6, 10**9, 2**63, 10**400, 0.5, -0.0, 1e-300, 1e300, math.nan, math.inf,
    "", "x" * 10_000, "\x00", "\ud800", "../..", [], [[]], {}, {"": None}, [0] * 10_000, {"a": [1, "b"]},
)  # fmt: skip

_TEXTS = (".bvh", ".csv", ".srt", ".textgrid", ".tsv", ".txt", ".vtt", ".yaml")
_MAX_LINE = 300_000  # letters to which the repetition of a line may let it grow


@st.composite
def damaged_bytes(draw: st.DrawFn, content: bytes) -> bytes:
    """Draw `content` after one to eight edits: bits, integers at odd values, ranges cut, repeated, moved or filled."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 8))):
        if not data:
            break
        start = draw(st.integers(0, len(data) - 1))
        stop = min(len(data), start + draw(st.sampled_from((1, 2, 4, 8, 64, 4096))))
        match draw(st.integers(0, 6)):
            case 0:
                data[start] ^= 1 << draw(st.integers(0, 7))
            case 1:
                size, order = draw(st.sampled_from((1, 2, 4, 8))), draw(st.sampled_from(("little", "big")))
                odd = draw(st.sampled_from(_ODD_INTEGERS)) % 256**size
                data[start : start + size] = odd.to_bytes(size, order)
            case 2:
                del data[start:stop]
            case 3:
                data[start:start] = data[start:stop] * draw(st.sampled_from((1, 2, 100)))
            case 4:
                del data[start:]
            case 5:
                data[start:stop] = draw(st.binary(max_size=16))
            case 6:
                target = draw(st.integers(0, len(data) - 1))
                data[target:target] = data[start:stop]
    return bytes(data)


@st.composite
def damaged_text(draw: st.DrawFn, text: str) -> bytes:
    """Draw `text` after edits of its lines and of the numbers and words in them, in UTF-8 or another encoding."""
    lines = text.splitlines(keepends=True)
    for _ in range(draw(st.integers(1, 6))):
        if not lines:
            break
        index = draw(st.integers(0, len(lines) - 1))
        match draw(st.integers(0, 5)):
            case 0:
                del lines[index]
            case 1:
                lines[index:index] = [lines[index]] * draw(st.sampled_from((1, 2, 500)))
            case 2:
                other = draw(st.integers(0, len(lines) - 1))
                lines[index], lines[other] = lines[other], lines[index]
            case 3:
                fields = lines[index].split(" ")
                fields[draw(st.integers(0, len(fields) - 1))] = draw(st.sampled_from(_ODD_NUMBERS))
                lines[index] = " ".join(fields)
            case 4:
                lines[index] = draw(st.text(max_size=20)) + lines[index]
            case 5:
                lines[index] = (lines[index] * draw(st.sampled_from((2, 300))))[:_MAX_LINE]
    encoding = draw(st.sampled_from(("utf-8", "utf-8", "utf-8", "utf-16", "latin-1")))
    return "".join(lines).encode(encoding, errors="replace")


@st.composite
def damaged_tree(draw: st.DrawFn, tree: Any) -> Any:
    """Draw a copy of nested dicts and lists in which one to four values are replaced, removed, renamed or repeated."""
    root = {"": copy.deepcopy(tree)}
    for _ in range(draw(st.integers(1, 4))):
        parent, key = draw(st.sampled_from(_places(root)))
        match draw(st.integers(0, 3)):
            case 0 | 1:
                parent[key] = copy.deepcopy(draw(st.sampled_from(_ODD_VALUES)))
            case 2 if parent is not root:
                del parent[key]
            case 3 if isinstance(parent, dict) and parent is not root:
                parent[draw(st.sampled_from(("", "x", "fps", "name")))] = parent.pop(key)
            case 3 if isinstance(parent, list):
                parent[key:key] = [copy.deepcopy(parent[key])] * draw(st.sampled_from((1, 1000)))
    return root[""]


@st.composite
def odd_array(draw: st.DrawFn, values: np.ndarray) -> np.ndarray:
    """Draw an array with another shape, type or value."""
    odd = draw(st.sampled_from((np.nan, np.inf, 0.0, -1.0, 1e-300, 1e-4, 1e12, 1e300, 1e30)))
    match draw(st.integers(0, 5)):
        case 0:
            return values[..., : draw(st.integers(0, 2))] if values.ndim else np.array([values, values])
        case 1:
            kinds = ("U8", "S8", "f2", "f8", "?") if values.dtype.kind == "f" else ("U8", "S8")
            return values.astype(draw(st.sampled_from(kinds))) if values.ndim else values[None]
        case 2:
            return np.array(odd)
        case 3:
            return values[: draw(st.integers(0, 2))] if values.ndim else np.zeros(3)
        case 4 if values.dtype.kind == "f":
            return np.where(np.arange(values.size).reshape(values.shape) == 7 % values.size, np.float64(odd), values)
        case _:
            return np.array(draw(st.sampled_from(("", "x" * 5000, "{}", "[1]", "3", '{"skeleton": []}', "\ud800"))))


@st.composite
def damaged_file(draw: st.DrawFn, name: str, content: bytes) -> bytes:
    """Draw the content of a file after damage to its bytes, or to what is in it by the suffix of its name."""
    suffix = pathlib.PurePath(name).suffix.lower()
    if draw(st.integers(0, 3)) == 0:
        return draw(damaged_bytes(content))
    file = io.BytesIO()
    if suffix == ".json":
        return json.dumps(draw(_damaged_part(json.loads(content)))).encode()
    if suffix in (".glb", ".vrma"):
        tree, blob = split_glb(content)
        return (
            join_glb(draw(_damaged_part(tree)), blob)
            if draw(st.booleans())
            else join_glb(tree, draw(damaged_bytes(blob)))
        )
    if suffix == ".npy":
        np.save(file, draw(odd_array(np.load(io.BytesIO(content)))))
        return file.getvalue()
    if suffix == ".npz":
        arrays = dict(np.load(io.BytesIO(content)))
        for array in draw(st.sets(st.sampled_from(sorted(arrays)), min_size=1)):
            if array == "meta" and draw(st.booleans()):
                arrays["meta"] = np.array(json.dumps(draw(damaged_tree(json.loads(str(arrays["meta"]))))))
            else:
                arrays[array] = draw(odd_array(arrays[array]))
        np.savez(file, **arrays)
        return file.getvalue()
    if suffix in _TEXTS:
        return draw(damaged_text(content.decode()))
    return draw(damaged_bytes(content[:400])) + content[400:]


@st.composite
def _damaged_part(draw: st.DrawFn, tree: Any) -> Any:
    """Draw a tree with damage to the whole of it, or to the value of one of its keys."""
    part = draw(st.sampled_from(("", *tree))) if isinstance(tree, dict) else ""
    return draw(damaged_tree(tree)) if not part else tree | {part: draw(damaged_tree(tree[part]))}


def _places(node: Any) -> list[tuple[Any, Any]]:
    """Return (container, key) of every value in `node`, at most 2,000 of them, and 20 of each list."""
    found: list[tuple[Any, Any]] = []
    stack = [node]
    while stack and len(found) < 2_000:
        container = stack.pop()
        keys = list(container) if isinstance(container, dict) else list(range(min(len(container), 20)))
        found.extend((container, key) for key in keys)
        stack.extend(container[key] for key in keys if isinstance(container[key], dict | list) and container[key])
    return found
