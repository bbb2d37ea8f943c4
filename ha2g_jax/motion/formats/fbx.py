"""FBX, which Blender writes: its Python module bpy, or the program."""

import importlib.resources
import importlib.util
import pathlib
import shutil
import subprocess
import sys
import tempfile

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.armature import Animation

_SCRIPT = "ha2g_blender.py"
# Folders of Blender on macOS and Windows, where it is not on PATH, and the program in them.
_PLACES = {
    "/Applications": "Blender*.app/Contents/MacOS/Blender",
    r"C:\Program Files\Blender Foundation": "Blender*/blender.exe",
}


def find_blender() -> list[str]:
    """Return the beginning of a command that runs the script of the Blender extension.

    Raises:
        UserError: there is neither bpy nor blender.
    """
    package = pathlib.Path(str(importlib.resources.files("ha2g_jax")))
    folders = (package / "assets" / "blender", package.parent / "integrations" / "blender")
    script = next((str(folder / _SCRIPT) for folder in folders if (folder / _SCRIPT).is_file()), _SCRIPT)
    if importlib.util.find_spec("bpy"):
        return [sys.executable, script, "--"]
    installed = [path for folder, program in _PLACES.items() for path in pathlib.Path(folder).glob(program)]
    if program := shutil.which("blender") or max(installed, default=None):  # the newest version
        return [str(program), "--background", "--python-exit-code", "1", "--python", script, "--"]
    raise UserError(
        "FBX is written by Blender, which is not on PATH; install it or its Python package bpy, or export .glb and "
        f"run, where Blender is: blender --background --python {script} -- MOTION.glb -o MOTION.fbx"
    )


def write(path: str | pathlib.Path, animation: Animation) -> None:
    """Write a `.fbx` file with the joints, the body and the motion of `gltf.write_glb`.

    Raises:
        UserError: there is no Blender, or it fails.
    """
    from ha2g_jax.motion.formats import gltf

    command = find_blender()
    with whole_file(path) as temporary, tempfile.TemporaryDirectory() as folder:
        motion = pathlib.Path(folder) / "motion.glb"
        gltf.write_glb(motion, animation)
        done = subprocess.run(
            [*command, str(motion), "-o", str(temporary)], capture_output=True, text=True, errors="replace", check=False
        )
        if done.returncode or not temporary.stat().st_size:
            lines = (done.stderr.strip() or done.stdout.strip() or "it says nothing").splitlines()
            raise UserError(f"Blender cannot write {shown(path)} ({shown(lines[-1])}); export .glb and open it there")
