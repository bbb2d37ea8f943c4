"""Settings of every test: CPU with 8 virtual devices, strict ranks, warnings as errors, fast compilation.

Nearly all of the time of the tests is compilation, so programs are compiled without optimisation and, where jaxlib has
it (before 0.11.1), by the older code generator of XLA, which takes a quarter of the time, and what was compiled is kept
in `.cache/jax`. These settings are variables of the environment, so that processes that tests start, notebooks among
them, have them as well.
"""

import functools
import gc
import os
import pathlib
import signal
import sys

import jaxlib.version

os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["XLA_FLAGS"] = (
    "--xla_force_host_platform_device_count=8 --xla_backend_optimization_level=0 "
    # Splitting programs for several threads takes an eighth more, and other workers have the cores.
    "--xla_cpu_parallel_codegen_split_count=1 "
    + ("--xla_cpu_use_fusion_emitters=false " if jaxlib.version.__version_info__ < (0, 11, 1) else "")
    + os.environ.get("XLA_FLAGS", "")  # of two equal flags the last holds
)
os.environ["JAX_COMPILATION_CACHE_DIR"] = os.environ.get(
    "JAX_COMPILATION_CACHE_DIR", str(pathlib.Path(__file__).parent.parent / ".cache" / "jax")
)
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
# Processes that compile one program at once may read half an entry of the other; it is compiled again.
os.environ["PYTHONWARNINGS"] = "ignore:Error reading persistent compilation cache entry:UserWarning"
# OpenBLAS's threads wait for each other in a loop, which takes the cores from other workers.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["HA2G_ONEDNN"] = "0"  # the tests of oneDNN use it all the same
# numba compiles librosa without optimisation here, and keeps the result apart from that of ordinary use.
os.environ["NUMBA_OPT"] = "0"
os.environ["NUMBA_CACHE_DIR"] = str(pathlib.Path(__file__).parent.parent / ".cache" / "numba")

import jax
import pytest

# Under nohup SIGHUP is ignored, by the processes that tests start as well; the tests are those of a terminal.
signal.signal(signal.SIGHUP, signal.SIG_DFL)

ROOT = pathlib.Path(__file__).parent.parent

# Folders and files whose tests wait long for other processes, then those that compile whole steps. They run first, so
# that one worker computes while another waits, and at the end two workers share what is quick.
SLOW = (
    "importers/video",
    "train",
    "methods",
    "test_extending.py",
    "test_notebooks.py",
    "experiments",
    "evaluation",
    "apps",
)

# What `make test` leaves to `make test-all`: damaged files by the thousand, commands that parsing has already checked,
# recipes of which it checks that they apply, clusters and further processes on this machine, long notebooks, a run that
# is stopped where one is killed already, further settings of streams, and further networks, data and precisions, of
# which each step is compiled.
THOROUGH = (
    "fuzz/",
    "apps/serve/test_server.py::test_sigterm_lets_a_request_and_a_stream_finish",
    "benchmarks/test_torch_peer.py::test_a_process_runs_its_steps",
    "checkpoint/released/test_released_torch.py::test_ha2g[ted_gesture-paper",
    "config/test_presets.py::test_baselines_of_equal_size_have_as_many_parameters_that_generate[medium",
    "config/test_presets.py::test_baselines_of_equal_size_have_as_many_parameters_that_generate[study",
    "config/test_presets.py::test_cells_of_the_factorial_study_have_as_many_parameters[medium",
    "config/test_presets.py::test_every_debug_preset_gives_a_step_in_float32[talk-joint_embedding-changes11",
    "config/test_presets.py::test_every_debug_preset_gives_a_step_in_float32[talk-seq2seq-changes10",
    "config/test_presets.py::test_every_debug_preset_gives_a_step_in_float32[ted_expressive-ha2g",
    "config/test_presets.py::test_every_debug_preset_gives_a_step_in_float32[ted_gesture-ha2g",
    "data/talk/test_build.py::test_workers_do_not_change_the_bytes",
    "data/talk/test_flite.py::test_workers_do_not_change_the_bytes",
    "evaluation/test_benchmark.py::test_a_precision_changes_the_types_of_the_step",
    "features/words/test_alignment.py::test_genuine_recordings[zeroeggs_neutral",
    "importers/ted/test_arrow.py::test_huge_declared_lengths_take_no_memory[4294967295",
    "importers/video/test_build.py::test_a_cluster_gives_the_same_bytes_and_survives_a_killed_worker",
    "importers/video/test_build.py::test_a_killed_build_goes_on_where_it_was",
    "importers/video/test_build.py::test_other_settings_do_the_videos_anew",
    "importers/video/test_pose.py::test_without_a_connection_one_line_says_so",
    "layers/cpu/test_onednn.py::test_gradients_of_gradients_of_any_shape",
    "layers/cpu/test_onednn.py::test_recurrence_and_its_gradients_of_both_orders[7-9-64",
    "layers/cpu/test_onednn.py::test_the_calls_are_compiled_once",
    "layers/test_gru.py::test_gradients_of_both_orders_are_those_of_the_steps[False",
    "layers/test_identity.py::test_resnet18_equals_pytorch_in_values_and_gradients[False",
    "methods/ha2g/test_method.py::test_parts_keep_less_for_the_gradient[images",
    "methods/ha2g/test_method.py::test_parts_on_eight_devices_give_the_update_of_the_whole_on_one",
    "methods/test_baselines.py::test_a_single_clip_is_evaluated_as_one_of_a_batch[seq2seq",
    "methods/test_baselines.py::test_a_single_clip_is_evaluated_as_one_of_a_batch[speech2gesture",
    "methods/test_baselines.py::test_eight_devices_take_the_step_of_one",
    "methods/test_baselines.py::test_half_precision_is_near_single_precision",
    "methods/test_baselines.py::test_one_batch_is_learnt_by_heart",
    "methods/test_methods.py::test_a_sound_moves_the_features_of_its_frame[25-68",
    "methods/test_speech2gesture.py::test_legacy_trains_as_the_published_comparison_did",
    "metrics/beats/test_times.py::test_processes_that_begin_at_once_share_one_good_store",
    "motion/control/test_effects.py::test_running_energy_scales_the_speed[ted_expressive-0-0",
    "motion/control/test_effects.py::test_running_energy_scales_the_speed[ted_expressive-1.5",
    "synthesis/test_running_motion.py::test_no_sample_after_the_look_ahead_changes_a_frame[0-1-True",
    "synthesis/test_running_motion.py::test_no_sample_after_the_look_ahead_changes_a_frame[3-1-False",
    "synthesis/test_running_motion.py::test_no_sample_after_the_look_ahead_changes_a_frame[3-4",
    "synthesis/test_running_motion.py::test_no_sample_after_the_look_ahead_changes_a_frame[8-2",
    "synthesis/test_stream.py::test_a_stream_makes_no_stroke_to_bursts_of_noise[-50",
    "synthesis/test_stream.py::test_a_stream_rests_within_a_second_of_silence[1",
    "synthesis/test_stream.py::test_a_stream_rests_within_a_second_of_silence[2",
    "synthesis/test_stream.py::test_a_stream_rests_within_a_second_of_silence[3",
    "synthesis/test_stream.py::test_the_memory_of_a_stream_does_not_grow[26",
    "synthesis/test_stream.py::test_what_was_cleared_is_forgotten_within_eight_frames[0-",
    "synthesis/test_stream.py::test_what_was_cleared_is_forgotten_within_eight_frames[4-",
    "synthesis/test_stream.py::test_what_was_cleared_is_forgotten_within_eight_frames[None-options1",
    "test_baselines.py",
    "test_docs_commands.py::test_commands_of_a_page_run",
    "test_extending.py::test_recipe_works",
    "test_notebooks.py::test_notebook_runs[02",
    "test_notebooks.py::test_notebook_runs[03",
    "test_notebooks.py::test_notebook_runs[04",
    "test_notebooks.py::test_notebook_runs[05",
    "test_notebooks.py::test_notebook_runs[06",
    "train/test_doctor.py::test_the_terms_and_their_sum_are_those_of_the_step",
    "train/test_hosts.py::test_a_process_that_fails_ends_the_others_and_two_keep_their_exit_codes[0]",
    "train/test_hosts.py::test_a_process_that_trains_keeps_its_programs[ha2g-arguments1",
    "train/test_hosts.py::test_a_run_of_two_processes_through_the_launcher",
    "train/test_loop.py::test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been",
    "train/test_loop.py::test_two_steps_on_images",
    "train/test_loop.py::test_two_steps_on_recordings",
    "train/test_resume.py::test_a_run_that_is_killed_ends_as_one_left_alone[3",
    "train/test_resume.py::test_sigterm_while_the_first_step_is_compiled_ends_a_run_in_time",
    "train/test_resume.py::test_the_soak_notices_what_differs[3",
    "train/test_sharding.py::test_two_processes_equal_one_and_agree_on_the_end",
    "train/test_step.py::test_bfloat16_changes_the_terms_by_little",
    "train/test_step.py::test_every_product_of_the_networks_is_in_bfloat16[speakers-1",
)

pytest_plugins = [
    "fixtures.torch_files",
    "fixtures.torch_layers",
    "fixtures.training",
]

jax.config.update("jax_numpy_rank_promotion", "raise")

# Bytecode is kept even where the environment says otherwise, as on many servers: the tests start a hundred processes.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

gc.disable()  # until all tests are imported, see `pytest_collection_finish`

# A shell starts background jobs with interrupts ignored, and the processes that tests interrupt would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of `THOROUGH`, and move slow tests to the beginning, in the order of `SLOW`."""

    def rank(item: pytest.Item) -> int:
        path = item.path.relative_to(ROOT / "tests").as_posix()
        return next((number for number, start in enumerate(SLOW) if path.startswith(start)), len(SLOW))

    for item in items:
        if item.nodeid.removeprefix("tests/").startswith(THOROUGH):
            item.add_marker(pytest.mark.thorough)
    items.sort(key=rank)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Let the garbage collector run rarely: it took a twelfth of the time, as tracing makes many small objects."""
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def shapes_once():
    """Trace equal networks once for their shapes: it takes half a second for each model that a test reads."""
    from ha2g_jax.checkpoint import model_folder

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model_folder, "variable_shapes", functools.cache(model_folder.variable_shapes))
        yield


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


@pytest.fixture(scope="session")
def debug_model():
    """A model of the debug size with random weights, two speakers and three seed poses."""
    return _draw_model("ha2g")


@pytest.fixture(scope="session")
def sampling_model():
    """The same of the method that samples, for which the noise of the seed counts."""
    return _draw_model("energy_ha2g")


def _draw_model(method: str):
    import numpy as np

    from ha2g_jax.checkpoint.assets import Assets
    from ha2g_jax.config import presets
    from ha2g_jax.features.text import Vocabulary
    from ha2g_jax.methods import build, variable_shapes
    from ha2g_jax.skeleton import load_skeleton, normalize
    from ha2g_jax.synthesis import Model

    skeleton = load_skeleton("ted_expressive")
    config = presets.change(presets.paper("ted_expressive", method), presets.SIZES["debug"])
    vocabulary = Vocabulary(("one", "two"))
    spec = build(config, skeleton, len(vocabulary), 2)
    shapes = variable_shapes(spec)
    random = np.random.default_rng(0)  # drawn here, because compiling the initialisation takes long
    variables = {
        "params": jax.tree.map(lambda x: random.normal(0, 0.1, x.shape).astype(np.float32), shapes["params"]),
        "batch_stats": jax.tree.map(lambda x: np.ones(x.shape, np.float32), shapes["batch_stats"]),
    }
    starts = skeleton.mean_directions + random.normal(0, 0.05, (3, spec.num_seed_frames, skeleton.num_bones, 3))
    assets = Assets(
        skeleton=skeleton,
        vocabulary=vocabulary,
        speakers={name: random.normal(size=18).astype(np.float32) for name in ("ada", "ben")},
        seed_poses=normalize(starts.astype(np.float32)),
        hash="0123456789abcdef",
    )
    return Model(spec, variables, assets, config)


@pytest.fixture(scope="session")
def debug_folder(debug_model, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The folder of `debug_model`; what changes it works on a copy."""
    from ha2g_jax.checkpoint import model_folder

    path = tmp_path_factory.mktemp("models") / "debug"
    return model_folder.save(path, debug_model.config, debug_model.assets, debug_model.variables)


@pytest.fixture(scope="session")
def sampling_onnx(sampling_model, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The ONNX file of `sampling_model`."""
    from ha2g_jax.checkpoint import model_folder
    from ha2g_jax.checkpoint.onnx.export import export

    path = tmp_path_factory.mktemp("models") / "sampling"
    model_folder.save(path, sampling_model.config, sampling_model.assets, sampling_model.variables)
    return export(path, path.with_suffix(".onnx"))


@pytest.fixture(scope="session")
def debug_onnx(debug_folder: pathlib.Path) -> pathlib.Path:
    """The ONNX file of `debug_model`."""
    from ha2g_jax.checkpoint.onnx.export import export

    return export(debug_folder, debug_folder.with_suffix(".onnx"))
