"""One training step of HA2G in PyTorch, in the two ways in which it may run the generator.

The encoders of audio, text and identity run once in any case. The cascade of pose stages runs for

  passes = 1: the true identities, once; what it returns trains the discriminator, detached, and then the generator, as
      in `ha2g_jax.train.step`.
  passes = 3: the discriminator, with identities that are drawn anew; the generator; and the second identities of the
      style term. The step of the published PyTorch implementation is described so: after the warm-up it runs the audio
      encoder once and the cascade three times, each in training mode with dropout of its own.

Both need the second identities: with `passes = 1` they are the only other run of the cascade. What needs no gradient,
the discriminator's own pass and the second identities, runs under `no_grad`, which only makes the step faster. So do
the fused Adam and the memory of images with the channels last.

Other than in ours, the GAN term of the generator moves the running statistics of the discriminator too, the state is
not checked for numbers that are not finite, and the first learning rate holds.
"""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.train.objective import Objective
from torch_peer import losses
from torch_peer.model import Discriminator, Generator


def check(config: Config) -> None:
    """Check that there is such a step for a config.

    Raises:
        UserError: the config has a method or a setting that the PyTorch step does not have.
    """
    found = {"method": config.method, "model.audio.kind": config.model.get("audio", {}).get("kind")}
    found |= {f"train.{name}": config.train[name] for name in ("dtype", "accumulate", "ema")}
    expected = ("ha2g", "resnet_se", "float32", 1, 0.0)
    for (name, value), only in zip(found.items(), expected, strict=True):
        if value != only:
            raise UserError(f"config.{name} is {value}; the PyTorch step has {only} only")


class TorchStep:
    """Networks, optimisers and the training step, with arrays of float32.

    Args:
        config: settings; read for the optimisers alone.
        objective: objective of our package, whose networks, terms and weights the step has.
        passes: number of runs of the cascade, see the top of the file.
        compiled: whether `torch.compile` compiles the networks and the terms.
        device: device of PyTorch, "cpu" or "cuda".

    Attributes:
        generator, discriminator: networks.
    """

    def __init__(
        self, config: Config, objective: Objective, *, passes: int = 1, compiled: bool = False, device: str = "cpu"
    ):
        check(config)
        self.spec, self.passes, self._device = objective.spec, passes, torch.device(device)
        self._weights, self._settings, self._gan = objective.weights._asdict(), objective.settings, objective.gan
        self._clip_norm = config.train.clip_norm
        with self._device:
            self.generator = Generator(self.spec).to(memory_format=torch.channels_last)
            self.discriminator = Discriminator(self.spec.discriminator, self.spec)
            self._physical = losses.Physical(self.spec.skeleton)
            self._mean = torch.tensor(self.spec.skeleton.mean_directions).flatten()
        self._optimizers = [
            torch.optim.Adam(network.parameters(), lr=float(rate(0)), betas=tuple(config.train.betas), fused=True)
            for network, rate in (
                (self.generator, objective.generator_rate),
                (self.discriminator, objective.discriminator_rate),
            )
        ]
        wrap = torch.compile if compiled else lambda function: function
        self._encode, self._infer = wrap(self.generator.encode), wrap(self.generator.infer)
        self._judge, self._terms = wrap(self.discriminator), wrap(self.terms)

    def tensors(self, batch: Mapping[str, Any]) -> dict[str, torch.Tensor]:
        """Return a batch of our package on the device; the indices become 64-bit, as an embedding takes them."""
        arrays = {name: np.asarray(array) for name, array in batch.items()}
        return {
            name: torch.from_numpy(array.astype(np.int64) if array.dtype == np.int32 else array.copy()).to(self._device)
            for name, array in arrays.items()
        }

    def run(self, batch: Mapping[str, torch.Tensor]) -> float:
        """Run one step and return its seconds."""
        started = time.perf_counter()
        self.step(batch)
        if self._device.type == "cuda":
            torch.cuda.synchronize()  # on the CPU the step returns when everything is computed
        return time.perf_counter() - started

    def step(self, batch: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Update the discriminator, then the generator.

        Args:
            batch: tensors by name, see `tensors`.

        Returns:
            The unweighted terms by name, and "total" and "discriminator".
        """
        targets = batch["directions"].flatten(2) - self._mean
        seed = targets[:, : self.spec.num_seed_frames]
        features, text, (mean, log_variance) = self._encode(batch["mel"], batch["words"], batch[self.spec.identity])
        f_id = _sample(mean, log_variance)
        if self.passes == 3:
            with torch.no_grad():
                fake = self._infer(features, _sample(mean, log_variance), seed)[-1]
            discriminator_loss = self._update_discriminator(targets, fake)
        poses = self._infer(features, f_id, seed)
        if self.passes == 1:
            discriminator_loss = self._update_discriminator(targets, poses[-1].detach())
        with torch.no_grad():
            shift = int(torch.randint(1, max(len(f_id), 2), ()))
            other_f_id = f_id.roll(shift, 0)
            other_poses = self._infer(features, other_f_id, seed)[-1]

        self.discriminator.requires_grad_(False)
        terms = self._terms(poses, features, text, mean, log_variance, (other_poses, f_id, other_f_id), targets)
        terms["gan"] = losses.gan_generator(self._judge(poses[-1]), self._gan)
        total = sum(self._weights[name] * term for name, term in terms.items())
        self._descend(self._optimizers[0], self.generator, total)
        self.discriminator.requires_grad_(True)
        terms |= {"total": total, "discriminator": discriminator_loss}
        return {name: term.detach() for name, term in terms.items()}

    def terms(self, poses, features, text, mean, log_variance, constants, targets) -> dict[str, torch.Tensor]:
        """Return the unweighted terms but the adversarial one; arguments as our `Outputs` and `Constants`."""
        settings, levels = self._settings, [targets[..., channels] for channels in self.generator.level_channels]
        return {
            "huber": losses.huber(poses, levels, settings.huber_delta),
            "physical": self._physical(poses[-1]),
            "style": losses.style(poses[-1], *constants, settings.style_delta, settings.style_clip),
            "kld": losses.kld(mean, log_variance),
            "contrastive": losses.contrastive(text, features, settings.temperature, settings.negatives),
        }

    def _update_discriminator(self, real: torch.Tensor, fake: torch.Tensor) -> torch.Tensor:
        loss = losses.gan_discriminator(self._judge(real), self._judge(fake), self._gan)
        self._descend(self._optimizers[1], self.discriminator, loss)
        return loss

    def _descend(self, optimizer: torch.optim.Optimizer, network: torch.nn.Module, loss: torch.Tensor) -> None:
        optimizer.zero_grad()
        loss.backward()
        if self._clip_norm:
            torch.nn.utils.clip_grad_norm_(network.parameters(), self._clip_norm)
        optimizer.step()


def _sample(mean: torch.Tensor, log_variance: torch.Tensor) -> torch.Tensor:
    return mean + (0.5 * log_variance).exp() * torch.randn_like(mean)
