"""Settings of every test: CPU with 8 virtual devices, strict ranks, warnings as errors, a compile cache."""

import os
import pathlib

os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"

import jax
import pytest

ROOT = pathlib.Path(__file__).parent.parent

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


@pytest.fixture(scope="session")
def private_data() -> pathlib.Path:
    """Real recordings that may not be shipped; the test is skipped where they are absent."""
    folder = pathlib.Path(os.environ.get("HA2G_PRIVATE_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no real recordings here (set HA2G_PRIVATE_DATA)")
    return folder


@pytest.fixture(scope="session")
def tiny_talk(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A Talk corpus of 4 speakers and 2 minutes."""
    from ha2g_jax.data.talk import build

    path = tmp_path_factory.mktemp("talk") / "tiny"
    build.make_talk(path, speakers=4, minutes=2, seed=0, workers=1)
    return path
