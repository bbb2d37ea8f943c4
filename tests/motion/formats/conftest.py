"""A hand-made animation, and readers of files that this project did not write, where they are installed."""

import json
import pathlib
import shutil
import subprocess
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from fixtures.blender import blender_python
from scipy.spatial.transform import Rotation

from ha2g_jax.motion import rigs
from ha2g_jax.motion.armature import Animation, ha2g_armature
from ha2g_jax.motion.rigs import retarget
from ha2g_jax.skeleton import load_skeleton

FPS = 15.0


def make_animation(skeleton: str = "ted_expressive", frames: int = 12, rig: str = "ha2g") -> Animation:
    """Arms that hang and swing, and every joint that carries a bone rotated a little, differently in every frame."""
    armature = ha2g_armature(load_skeleton(skeleton))
    random = np.random.default_rng(0)
    swing = random.normal(0, 0.15, (1, len(armature.joints), 3))
    phase = np.linspace(0, 4, frames)[:, None, None] + random.uniform(0, 6, (1, len(armature.joints), 1))
    vectors = swing * np.sin(phase)
    for side, sign in (("left", -1), ("right", 1)):
        vectors[:, armature.joint(f"{side}_shoulder")] += [0, 0, 1.2 * sign]
        vectors[:, armature.joint(f"{side}_elbow")] += [0, 1.4 * sign, 0]
    ends = [index for index in range(len(armature.joints)) if index not in armature.parents]
    crossings = [armature.joint(name) for name in ("neck", "nose") if name in armature.joints]
    vectors[:, [*ends, *crossings]] = 0
    local = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_quat().reshape(frames, -1, 4)
    animation = Animation(armature, local, np.zeros((frames, 3)), FPS, {"seed": 3, "speech": "a.wav"})
    return retarget(animation, rigs.load_rig(rig))


@pytest.fixture(scope="session")
def animate() -> Callable[..., Animation]:
    """`make_animation`."""
    return make_animation


@pytest.fixture(scope="session")
def blender() -> Callable[..., dict[str, np.ndarray]]:
    """Reads joints' positions (frames, 3), metres, y up, of a file in Blender, in a process of its own."""
    python = blender_python()
    script = pathlib.Path(__file__).parent / "blender_positions.py"

    def read(path: pathlib.Path, frames: Sequence[int], fps: float = FPS) -> dict[str, np.ndarray]:
        out = path.with_suffix(".positions.json")
        command = [python, str(script), str(path), str(out), str(fps), *map(str, frames)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert out.is_file(), done.stdout + done.stderr
        return {name: np.array(values) for name, values in json.loads(out.read_text()).items()}

    return read


@pytest.fixture(scope="session")
def validator() -> Callable[[pathlib.Path], dict]:
    """The Khronos glTF validator's report on a file."""
    node = shutil.which("node") or ""
    script = "const v = require('gltf-validator'); const fs = require('fs');"
    if not node or subprocess.run([node, "-e", script], capture_output=True, check=False).returncode:
        pytest.skip("no Khronos validator here (npm install gltf-validator, and set NODE_PATH)")
    script += "v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))"
    script += ".then(report => console.log(JSON.stringify(report)));"

    def validate(path: pathlib.Path) -> dict:
        done = subprocess.run([node, "-e", script, str(path)], capture_output=True, text=True, check=True)
        return json.loads(done.stdout)

    return validate
