"""HA2G on motion capture with fingers: a folder made by ha2g data import-bvh or import-smplx.

ha2g data import-bvh RECORDINGS corpora/mocap && ha2g data split corpora/mocap corpora/mocap_split
ha2g train --config experiments/configs/bvh.py --workdir runs/mocap --config.data.path=corpora/mocap_split
"""

from ha2g_jax import config as configs


def get_config(size: str = "paper") -> configs.Config:
    config = configs.sized(configs.paper("ted_expressive"), size)
    config.model.identity.kind = "speakers"  # motion capture has no images
    config.data.jitter = 9  # windows start every 10 frames, so that training sees every start
    return config
