"""The recipes of a cluster, as far as they can be checked without one."""

import re
import shlex
import tomllib

import pytest
from helpers import ROOT
from helpers.commands import parsed_only

from mitsvbrdf import __version__, cli

yaml = pytest.importorskip("yaml")
FOLDER = ROOT / "docs/cluster"

# Names that KubeRay's ray.io/v1 takes, from ray-operator/apis/ray/v1/rayjob_types.go and raycluster_types.go.
JOB = {"activeDeadlineSeconds", "backoffLimit", "rayClusterSpec", "submitterPodTemplate", "metadata",
       "clusterSelector", "submitterConfig", "managedBy", "deletionStrategy", "entrypoint", "runtimeEnvYAML",
       "jobId", "submissionMode", "entrypointResources", "entrypointNumCpus", "entrypointNumGpus",
       "ttlSecondsAfterFinished", "shutdownAfterJobFinishes", "suspend"}
CLUSTER = {"headGroupSpec", "workerGroupSpecs", "rayVersion", "enableInTreeAutoscaling", "autoscalerOptions",
           "headServiceAnnotations", "suspend"}
HEAD = {"serviceType", "headService", "enableIngress", "rayStartParams", "template"}
WORKERS = {"groupName", "replicas", "minReplicas", "maxReplicas", "numOfHosts", "rayStartParams", "template",
           "scaleStrategy"}


def read(name: str) -> dict:
    return yaml.safe_load((FOLDER / name).read_text())


def test_ray_accepts_the_launcher_file():
    """Ray's own schema and rules, with its defaults for AWS filled in as `ray up` does."""
    pytest.importorskip("ray")
    pytest.importorskip("jsonschema")
    from ray.autoscaler._private.util import prepare_config, validate_config

    config = prepare_config(read("ray-autoscaler.yaml"))
    validate_config(config)
    types = config["available_node_types"]
    assert types[config["head_node_type"]]["resources"] == {"CPU": 0} and types["worker"]["resources"] == {
        "CPU": 16}
    assert config["max_workers"] * 16 >= 1000
    with pytest.raises(Exception, match="Additional properties"):
        validate_config(config | {"workers": 3})  # the check is not vacuous


def test_the_head_does_no_fits():
    assert "--num-cpus=0" in read("ray-autoscaler.yaml")["head_start_ray_commands"][-1]
    assert read("rayjob.yaml")["spec"]["rayClusterSpec"]["headGroupSpec"]["rayStartParams"]["num-cpus"] == "0"


def test_the_ray_job_has_only_names_that_kuberay_knows():
    job = read("rayjob.yaml")
    assert (job["apiVersion"], job["kind"]) == ("ray.io/v1", "RayJob")
    cluster = job["spec"]["rayClusterSpec"]
    (workers,) = cluster["workerGroupSpecs"]
    assert set(job["spec"]) <= JOB and set(cluster) <= CLUSTER
    assert set(cluster["headGroupSpec"]) <= HEAD and set(workers) <= WORKERS
    for group in (cluster["headGroupSpec"], workers):
        assert all(isinstance(value, str) for value in group["rayStartParams"].values())
        pod = group["template"]["spec"]
        (container,) = pod["containers"]
        assert {each["name"] for each in container["volumeMounts"]} == {each["name"]
                                                                        for each in pod["volumes"]}
        assert container["resources"]["requests"] == container["resources"]["limits"]
    assert workers["replicas"] * int(workers["rayStartParams"]["num-cpus"]) >= 1000
    (memory,) = re.findall(r"--memory ([\d.]+)", job["spec"]["entrypoint"])
    assert 16 * float(memory) <= int(container["resources"]["limits"]["memory"].removesuffix("Gi"))


def test_versions_are_those_of_the_package():
    job, image = read("rayjob.yaml")["spec"]["rayClusterSpec"], (FOLDER / "Dockerfile").read_text()
    assert f"ray[default]=={job['rayVersion']}" in image
    assert job["headGroupSpec"]["template"]["spec"]["containers"][0]["image"].endswith(f":{__version__}")
    assert read("ray-autoscaler.yaml")["docker"]["image"].endswith(f":{__version__}")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert "/src[batch]" in image and "batch" in extras


def test_their_command_is_understood(monkeypatch):
    (launched,) = re.findall(r"'(mitsvbrdf batch .*)'", (FOLDER / "ray-autoscaler.yaml").read_text())
    assert launched == read("rayjob.yaml")["spec"]["entrypoint"]
    called = parsed_only(monkeypatch)
    assert cli.main(shlex.split(launched)[1:]) == 0
    ((name, options),) = called
    settings = options["running"]
    assert (name, settings.address, settings.workers, settings.memory) == ("batch", "auto", 1000, 1.8)
