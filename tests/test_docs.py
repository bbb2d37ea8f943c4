"""The pages of docs: links are right, and the scripts of scaling.md run with stand-ins for the cluster."""

import os
import pathlib
import re
import signal
import subprocess
import tomllib
from xml.etree import ElementTree

import pytest
import yaml

from ha2g_jax import launch

ROOT = pathlib.Path(__file__).parent.parent
PAGES = [
    *(ROOT / name for name in ("README.md", "SECURITY.md", "CONTRIBUTING.md", "CODE_OF_CONDUCT.md", "CHANGELOG.md")),
    *(ROOT / name for name in ("benchmarks/README.md", "experiments/README.md", "integrations/web/README.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
PAGE = (ROOT / "docs" / "scaling.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
SLURM, KUBERNETES = (text for language, text in BLOCKS if language == "bash")


@pytest.fixture
def program(tmp_path, monkeypatch):
    """A function from a name and a line of shell to a program of that name, which the scripts find first."""
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")

    def program(name, line):
        (tmp_path / "bin" / name).write_text(f"#!/bin/bash\n{line}\n")
        (tmp_path / "bin" / name).chmod(0o755)

    return program


def _with_names(script, **names):
    for name, value in names.items():
        script, count = re.subn(rf"(?m)^{name}=\S+", f"{name}={value}", script)
        assert count == 1, name
    return script


def _bash(script):
    return subprocess.run(["bash", "-euo", "pipefail", "-c", script], capture_output=True, text=True, check=False)


def test_slurm_reads_all_its_lines():
    lines = [line for line in SLURM.splitlines() if line]
    commands = [number for number, line in enumerate(lines) if not line.startswith("#")]
    assert not any(line.startswith("#SBATCH") for line in lines[commands[0] :])  # Slurm stops at the first command


@pytest.mark.parametrize(("last_step", "code", "requeued"), [(10, 0, True), (20, 0, False), (10, 2, False)])
def test_slurm_goes_on_until_the_last_step_is_there(last_step, code, requeued, program, tmp_path, monkeypatch):
    monkeypatch.setenv("SLURM_JOB_ID", "7")
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "4")
    environment = tmp_path
    program("srun", 'while [[ "$1" == --* ]]; do shift; done; exec "$@"')
    program(
        "ha2g", f'printf "%s\\n" "$@" > {tmp_path}/arguments; mkdir -p {tmp_path}/run/latest/{last_step}; exit {code}'
    )
    program("scontrol", f'echo "$@" > {tmp_path}/scontrol')
    names = {"ENVIRONMENT": environment, "CONFIG": "talk:paper", "WORKDIR": tmp_path / "run", "STEPS": 20}
    done = subprocess.run(["bash", "-c", _with_names(SLURM, **names)], check=False)
    assert done.returncode == code
    assert (tmp_path / "scontrol").exists() is requeued
    command, *flags = (tmp_path / "arguments").read_text().split()
    assert command == "train"
    overrides = [flag for flag in flags if flag.startswith("--config.")]
    assert launch.load_config("talk:paper", overrides).train.steps == 20


@pytest.fixture
def manifest(program):
    """The service and the job that the script for Kubernetes applies."""
    program("kubectl", '[ "$*" = "apply -f -" ] && cat')
    done = _bash(KUBERNETES)
    assert done.returncode == 0, done.stderr
    return yaml.safe_load_all(done.stdout)


def test_pods_of_kubernetes_find_the_first_of_them(manifest):
    service, job = manifest
    name, spec = job["metadata"]["name"], job["spec"]
    (container,) = spec["template"]["spec"]["containers"]
    variables = {entry["name"]: entry["value"] for entry in container["env"]}
    assert service["spec"]["clusterIP"] == "None"
    assert service["spec"]["selector"] == {"batch.kubernetes.io/job-name": name}
    assert spec["template"]["spec"]["subdomain"] == service["metadata"]["name"]
    (port,) = service["spec"]["ports"]
    assert variables["JAX_COORDINATOR_ADDRESS"] == f"{name}-0.{service['metadata']['name']}:{port['port']}"
    assert spec["completionMode"] == "Indexed"
    assert str(spec["completions"]) == str(spec["parallelism"]) == variables["JAX_NUM_PROCESSES"]
    mounted = {mount["name"] for mount in container["volumeMounts"]}
    assert mounted == {volume["name"] for volume in spec["template"]["spec"]["volumes"]}


@pytest.mark.parametrize(("last_step", "code", "expected"), [(10, 0, 75), (20, 0, 0), (10, 2, 2)])
def test_a_pod_is_told_to_stop_and_is_done_only_after_the_last_step(last_step, code, expected, program, tmp_path):
    program("kubectl", "cat")
    stop = f"mkdir -p {tmp_path}/run/latest/{last_step}; exit {code}"
    program("ha2g", f"trap 'kill $!; {stop}' TERM\nsleep 600 &\necho started\nwait")
    _, job = yaml.safe_load_all(_bash(_with_names(KUBERNETES, WORKDIR=tmp_path / "run", STEPS=20)).stdout)
    container = job["spec"]["template"]["spec"]["containers"][0]
    with subprocess.Popen([*container["command"], *container["args"]], stdout=subprocess.PIPE, text=True) as pod:
        assert pod.stdout is not None and pod.stdout.readline() == "started\n"
        pod.send_signal(signal.SIGTERM)
        assert pod.wait(60) == expected
    rules = job["spec"]["podFailurePolicy"]["rules"]
    ignored = [number for rule in rules for number in rule.get("onExitCodes", {}).get("values", [])]
    assert (expected in ignored) is (expected == 75)
    assert job["spec"]["template"]["spec"]["restartPolicy"] == "Never"  # which a podFailurePolicy asks for


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_a_page_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text())
    assert not [link for link in links if "://" not in link and not (page.parent / link).exists()]


def test_pages_that_the_code_names_exist():
    """Helps, messages and comments send a reader to pages."""
    code = [path.read_text() for path in (ROOT / "ha2g_jax").rglob("*.py")]
    named = {name for text in code for name in re.findall(r"\bdocs/[\w/]+\.md", text)}
    assert len(named) > 10 and not [name for name in named if not (ROOT / name).exists()]


def test_diagram_of_the_packages_has_those_of_the_contract():
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
    rows = [[name.removeprefix("ha2g_jax.") for name in row.split(" | ")] for row in contract["layers"]]
    diagrams = {path.stem: path for path in (ROOT / "docs" / "images").glob("*.svg")}
    assert set(diagrams) == {"data-flow", "method", "packages"}
    trees = {name: ElementTree.parse(path).getroot() for name, path in diagrams.items()}
    bold = [element.text for element in trees["packages"].iter() if element.get("font-weight") == "bold"]
    assert ", ".join(filter(None, bold)).split(", ") == [name for row in rows for name in row]
