"""The files of integrations/deploy/ fit the command and each other; neither Docker nor a cluster is needed."""

import http.server
import json
import pathlib
import re
import shlex
import threading
import tomllib
import urllib.error

import pytest
import yaml

from ha2g_jax import cli
from ha2g_jax.apps.serve import workers
from ha2g_jax.apps.serve.guard import OPEN

ROOT = pathlib.Path(__file__).parents[3]
DEPLOY = ROOT / "integrations" / "deploy"
DEPLOYMENT, SERVICE, SCALER = yaml.safe_load_all((DEPLOY / "kubernetes.yaml").read_text())
POD = DEPLOYMENT["spec"]["template"]["spec"]
(CONTAINER,) = POD["containers"]
DOCKERFILE = (DEPLOY / "Dockerfile").read_text()
ENTRYPOINT = json.loads(re.findall(r"^ENTRYPOINT (.*)$", DOCKERFILE, re.MULTILINE)[0])


def parsed(arguments):
    return cli.make_parser().parse_args([*ENTRYPOINT[1:], *arguments])


def test_the_command_knows_the_arguments_of_the_image_and_the_pod():
    assert ENTRYPOINT[0] == "ha2g" and parsed([]).host == "0.0.0.0" and parsed([]).token is None
    assert str(parsed([]).port) in re.findall(r"^EXPOSE (\d+)", DOCKERFILE, re.MULTILINE)
    assert parsed(CONTAINER["args"]).workers == int(CONTAINER["resources"]["requests"]["cpu"])
    for line in re.findall(r"^# +docker run (.*)$", DOCKERFILE, re.MULTILINE):
        assert f"127.0.0.1:{parsed([]).port}:{parsed([]).port}" in shlex.split(line)


def test_probes_ask_the_route_that_needs_no_token():
    for name in ("startupProbe", "readinessProbe", "livenessProbe"):
        assert CONTAINER[name]["httpGet"] == {"path": OPEN, "port": "http"}
    assert f"http://127.0.0.1:{parsed([]).port}{OPEN}" in DOCKERFILE
    assert parsed(CONTAINER["args"]).origin == [f"http://{SERVICE['metadata']['name']}"]  # 421 otherwise
    (port,) = CONTAINER["ports"]
    assert port == {"name": "http", "containerPort": parsed([]).port}
    assert SERVICE["spec"]["ports"][0]["targetPort"] == "http"


def test_the_health_check_of_the_image_asks_past_a_proxy(monkeypatch):
    (check,) = re.findall(r"^HEALTHCHECK .*\n +(\[.*\])$", DOCKERFILE, re.MULTILINE)
    code = json.loads(check)[2]
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    with http.server.HTTPServer(("127.0.0.1", 0), http.server.SimpleHTTPRequestHandler) as server:
        threading.Thread(target=server.handle_request, daemon=True).start()
        with pytest.raises(urllib.error.HTTPError, match="404"):  # answered, not by the proxy
            exec(code.replace(":8000/", f":{server.server_port}/"), {})


def test_a_pod_is_killed_only_after_the_grace():
    before = int(CONTAINER["lifecycle"]["preStop"]["exec"]["command"][1])
    most = before + parsed(CONTAINER["args"]).grace + 2 * workers.MARGIN
    assert POD["terminationGracePeriodSeconds"] >= most


def test_parts_of_the_manifest_name_each_other():
    labels = DEPLOYMENT["spec"]["template"]["metadata"]["labels"]
    assert labels == DEPLOYMENT["spec"]["selector"]["matchLabels"] == SERVICE["spec"]["selector"]
    assert SCALER["spec"]["scaleTargetRef"]["name"] == DEPLOYMENT["metadata"]["name"]
    assert {mount["name"] for mount in CONTAINER["volumeMounts"]} == {volume["name"] for volume in POD["volumes"]}
    assert f"USER {POD['securityContext']['runAsUser']}" in DOCKERFILE


def test_the_image_copies_what_the_package_is_built_from_and_what_is_not_ignored():
    kept = re.findall(r"^!(.*)$", (DEPLOY / "Dockerfile.dockerignore").read_text(), re.MULTILINE)
    copied = {name for line in re.findall(r"^COPY (?!--)(.*) \S+$", DOCKERFILE, re.MULTILINE) for name in line.split()}
    assert copied == set(kept) and all((ROOT / name).exists() for name in kept)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert included and all(copied & {path, *map(str, pathlib.PurePosixPath(path).parents)} for path in included)
