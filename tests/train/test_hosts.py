"""Processes find each other by flags, Slurm or Kubernetes, all end when one fails, and each keeps its programs."""

import os
import pathlib
import subprocess
import sys
import threading

import jax
import pytest
from train import processes

from ha2g_jax.errors import UserError
from ha2g_jax.train import hosts
from ha2g_jax.train.workdir import read_metrics

SLURM = {
    "SLURM_JOB_ID": "1234",
    "SLURM_STEP_NODELIST": "node[07-08]",
    "SLURM_STEP_NUM_NODES": "2",
    "SLURM_STEP_NUM_TASKS": "8",
    "SLURM_NTASKS": "8",
    "SLURM_PROCID": "5",
    "SLURM_LOCALID": "1",
}


@pytest.fixture
def joined(monkeypatch):
    """The arguments of `jax.distributed.initialize`, in an environment without its variables."""
    for name in (*SLURM, "JAX_COORDINATOR_ADDRESS", "JAX_NUM_PROCESSES", "JAX_PROCESS_ID", "JOB_COMPLETION_INDEX"):
        monkeypatch.delenv(name, raising=False)
    calls = []
    monkeypatch.setattr(jax.distributed, "initialize", lambda **settings: calls.append(settings))
    return calls


ALONE = {
    "nothing": {},
    "an interactive shell of Slurm": SLURM | {"SLURM_STEP_NUM_TASKS": "1"},
    "a batch script": {name: value for name, value in SLURM.items() if "STEP" not in name},
    "a task of an srun that is told so": SLURM,
    "an indexed job of single processes": {"JOB_COMPLETION_INDEX": "3"},
    "a job of one": {"JAX_COORDINATOR_ADDRESS": "a:1", "JAX_NUM_PROCESSES": "1", "JAX_PROCESS_ID": "0"},
}


@pytest.mark.parametrize("case", ALONE)
def test_one_process_joins_nobody(case, joined, monkeypatch):
    for name, value in ALONE[case].items():
        monkeypatch.setenv(name, value)
    hosts.start(None, 1 if "told" in case else None, None)
    hosts.stop()
    assert not joined and hosts.is_first()


def test_flags_go_before_variables(joined, monkeypatch):
    monkeypatch.setenv("JAX_COORDINATOR_ADDRESS", "ha2g-0.ha2g:8476")
    monkeypatch.setenv("JAX_NUM_PROCESSES", "4")
    monkeypatch.setenv("JOB_COMPLETION_INDEX", "3")
    hosts.start(None, None, None)
    hosts.start(None, None, 2)
    hosts.start("node1:1", 2, 0)
    names = ("coordinator_address", "num_processes", "process_id")
    assert [tuple(call[name] for name in names) for call in joined] == [
        ("ha2g-0.ha2g:8476", 4, 3),
        ("ha2g-0.ha2g:8476", 4, 2),
        ("node1:1", 2, 0),
    ]


@pytest.mark.parametrize(
    ("nodes", "visible", "devices"),
    [("2", "0,1,2,3", None), ("8", "0,1,2,3", []), ("2", "1", []), ("2", "", None)],
    ids=["one a GPU", "one a node", "one bound to a GPU", "no GPUs"],
)
def test_slurm_tasks_share_the_devices_of_their_node(nodes, visible, devices, joined, monkeypatch):
    monkeypatch.delenv("JAX_LOCAL_DEVICE_IDS", raising=False)
    for name, value in (SLURM | {"SLURM_STEP_NUM_NODES": nodes, "CUDA_VISIBLE_DEVICES": visible}).items():
        monkeypatch.setenv(name, value)
    hosts.start(None, None, None)
    (call,) = joined
    assert (call["cluster_detection_method"], call["local_device_ids"]) == ("slurm", devices)


def test_flags_that_do_not_fit_together_are_refused(joined):
    with pytest.raises(UserError, match="process_id is 2 of 2 processes"):
        hosts.start("node1:1", 2, 2)
    assert not joined


def test_processes_that_do_not_come_are_waited_for_only_so_long(joined, monkeypatch):
    released = threading.Event()
    monkeypatch.setattr(jax.distributed, "initialize", lambda **_: released.wait())
    monkeypatch.setattr(hosts, "_JOIN_SECONDS", 0.1)
    with pytest.raises(UserError, match="not all processes of the run have joined at node1:1"):
        hosts.start("node1:1", 2, 1)
    released.set()


PRINT_PLACE = """
import jax
from ha2g_jax.train import hosts
hosts.start(None, None, None)
print(f"place {jax.process_index()} {jax.process_count()} {jax.device_count()} {hosts.is_first()}")
hosts.stop()
"""


def test_tasks_of_slurm_join():
    port = processes.free_address().split(":")[1]
    shared = SLURM | {"SLURM_STEP_NUM_TASKS": "2", "SLURM_NTASKS": "2", "SLURM_STEP_NUM_NODES": "1"}
    shared |= {"SLURM_STEP_NODELIST": "localhost", "JAX_COORDINATOR_PORT": port}
    variables = [shared | {"SLURM_PROCID": number, "SLURM_LOCALID": number} for number in "01"]
    results = processes.finish([[sys.executable, "-c", PRINT_PLACE]] * 2, 2, variables)
    for number, (code, output) in enumerate(results):
        assert code == 0 and f"place {number} 2 4 {number == 0}" in output, output


FAIL = """
import sys
from ha2g_jax.train import hosts
hosts._PART_SECONDS = 2
hosts.start(sys.argv[1], 2, int(sys.argv[2]))
if sys.argv[2] in sys.argv[3]:
    print("failed", flush=True)
    sys.exit(2)
hosts.stop()  # stands for a step: it waits for the other
"""


@pytest.mark.parametrize("failing", ["0", "1", "01"])
def test_a_process_that_fails_ends_the_others_and_two_keep_their_exit_codes(failing):
    address = processes.free_address()
    results = processes.finish([[sys.executable, "-c", FAIL, address, number, failing] for number in "01"])
    if failing == "01":
        assert [code for code, _ in results] == [2, 2]
        return
    (code, output), (waiting, _) = results[int(failing)], results[1 - int(failing)]
    assert code == 1 and output.splitlines()[-1] == "failed"
    assert waiting not in (0, None)


def test_a_run_of_two_processes_through_the_launcher(tiny_talk, tmp_path):
    workdir, address = tmp_path / "run", processes.free_address()
    common = [sys.executable, "-m", "ha2g_jax.cli", "train", "--config=seq2seq:talk:debug", f"--workdir={workdir}"]
    common += [f"--config.data.path={tiny_talk}", "--config.train.devices=0"]
    commands = [[*common, f"--coordinator={address}", "--num_processes=2", f"--process_id={n}"] for n in "01"]
    first, second = processes.finish(commands)
    assert (first[0], second[0]) == (0, 0), f"{first[1]}\n---\n{second[1]}"
    assert str(workdir) in first[1].splitlines() and str(workdir) not in second[1].splitlines()
    assert [line["step"] for line in read_metrics(workdir / "metrics.jsonl")] == [1, 2, 2]
    assert [path.name for path in (workdir / "latest").iterdir() if path.is_dir()] == ["2"]


ROOT = pathlib.Path(__file__).parents[2]
PROGRAM = """
import runpy, sys
script, *sys.argv[1:] = sys.argv[1:]
try:
    runpy.run_path(script, run_name="__main__")
except SystemExit:
    pass
import jax
print(jax.config.jax_compilation_cache_dir)
"""


@pytest.mark.parametrize(
    ("script", "arguments"),
    [("ha2g", ["train", "--config=none"]), ("ha2g", ["doctor", "--config=none"]), ("launch", ["--config=none"])],
)
def test_a_process_that_trains_keeps_its_programs(script, arguments, tmp_path):
    path = {"ha2g": pathlib.Path(sys.executable).with_name("ha2g"), "launch": ROOT / "experiments" / "launch.py"}
    environment = {name: value for name, value in os.environ.items() if "COMPILATION_CACHE" not in name}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path[script]), *arguments],
        env=environment | {"HA2G_CACHE": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split()[-1:] == [str(tmp_path / "programs")], done.stderr
