"""The generator of a stream: windows every few frames, each continuing the one before, in a style that may change."""

import numpy as np

from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.errors import UserError
from ha2g_jax.features.spectrum import FLOOR_DB, NUM_MELS, window_columns
from ha2g_jax.methods.method import Spec, Variables
from ha2g_jax.motion.control.effects import Ramp
from ha2g_jax.motion.rotations import unit
from ha2g_jax.synthesis.scan import generate_window, noise_of
from ha2g_jax.synthesis.style import Style, choose_style

_REST_WINDOWS = 3  # windows of silence until a model is at rest

# Share of the mean pose in the seed pose of a model that samples. A window exaggerates its seed pose a little, and in a
# stream the next window continues from it two frames later: without this share the hands drift apart. With a larger
# share they spread less; it was chosen on the validation split of Talk. With a hop of 1 it would make them shake. Near
# rest the share vanishes with the cube of the distance from rest: if it were proportional to the distance, the hands
# would not come to rest in noise.
_MEAN_SHARE = 0.6


class RunningGenerator:
    """Generator of the windows of a stream, each `hop` frames after the one before.

    A new style, and the pose in which the model rests with it, take effect within half a second.

    Attributes:
        seed_pose: (M, bones, 3) poses that the stream starts from.
        rest: (bones, 3) rest pose in the current window.

    Raises:
        UserError: the style cannot be used, see `choose_style`, or the values of the model are not finite.
    """

    def __init__(self, spec: Spec, variables: Variables, assets: Assets, style: Style, seed: int, hop: int):
        self._spec, self._variables, self._assets, self._seed, self._hop = spec, variables, assets, seed, hop
        self.seed_pose = assets.seed_poses[assets.choose_seed_pose(seed)]
        self.style = style  # the program is compiled here
        self._style_ramp, self._rest_ramp = Ramp(self._f_id, spec.fps), Ramp(self._rest_pose.ravel(), spec.fps)
        self._present, self.rest = self._f_id, self._rest_pose

    @property
    def style(self) -> Style:
        """Requested style."""
        return self._style

    @style.setter
    def style(self, style: Style) -> None:
        self._f_id, _ = choose_style(self._spec, self._variables, self._assets, style, self._seed)
        self._style = style
        self._rest_pose = self._find_rest()

    def advance(self) -> None:
        """Go on to the next window, and update the style and the rest pose."""
        self._present = np.asarray(self._style_ramp.step(self._f_id, self._hop), np.float32)
        rest = self._rest_ramp.step(self._rest_pose.ravel(), self._hop)
        self.rest = unit(rest.reshape(self._rest_pose.shape))

    def window(self, mel: np.ndarray, poses: np.ndarray, first: int) -> np.ndarray:
        """Return the poses (N, bones, 3) of the current window, whose first frame has the number `first`.

        Args:
            mel: (128, columns) spectrogram of the window.
            poses: (M, bones, 3) poses that the stream has in the first frames of the window.
        """
        if self._spec.noise_dim and self._hop > 1:
            mean = self._spec.skeleton.mean_directions
            distance = np.linalg.norm(poses - self.rest, axis=(1, 2), keepdims=True) / np.linalg.norm(mean - self.rest)
            share = _MEAN_SHARE * np.minimum(distance, 1) ** 3
            poses = unit(poses + share * (mean - poses)).astype(np.float32)
        return self._generate(mel, self._present, poses, first)

    def _find_rest(self) -> np.ndarray:
        """Return the pose (bones, 3) in which the model comes to rest in silence with the requested style."""
        num_frames, num_seed_frames = self._spec.num_frames, self._spec.num_seed_frames
        silence = np.full((NUM_MELS, window_columns(num_frames, self._spec.fps)), FLOOR_DB, np.float32)
        window = self.seed_pose
        for index in range(_REST_WINDOWS):
            first = index * (num_frames - num_seed_frames)
            window = self._generate(silence, self._f_id, window[-num_seed_frames:], first)
        return unit(window.mean(axis=0))

    def _generate(self, mel: np.ndarray, style: np.ndarray, seed_pose: np.ndarray, first: int) -> np.ndarray:
        noise = noise_of(self._spec, self._seed, np.asarray(first))
        window = np.asarray(generate_window(self._spec, self._variables, {"mel": mel}, style, seed_pose, noise))
        if not np.isfinite(window).all():
            raise UserError(f"model {self._assets.hash} generated values that are not finite; train or export it again")
        return window
