"""`drsplat doctor`: what it says of machines that lack things."""

import json
import re
import subprocess
import sys
from importlib.metadata import requires, version
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import pytest

from drsplat.cli import main
from drsplat.errors import pip_install
from drsplat.fronts.commands import doctor
from drsplat.kernels import available_isas, default_isa

MODELS = "masks and embeddings of real models (SAM, CLIP)"
CUDA = "train, register, render on a CUDA GPU"
FINE: dict[str, Any] = {"torch_fault": None, "torchvision_fault": None, "cuda": [], "mps": False}
has_torch, has_hub = (find_spec(name) is not None for name in ("torch", "huggingface_hub"))


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """What the doctor finds; tests take from it. Torch is never imported for real."""
    names = {"torch", "transformers", *({"huggingface_hub"} if has_hub else ())}  # which is asked for real
    monkeypatch.setattr(doctor, "_is_installed", lambda name: name in names)
    monkeypatch.setattr(doctor, "_probed", lambda: FINE)
    return names


def asked(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main(["doctor", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert isinstance(answer, dict)
    return answer


def test_this_machine_as_it_is(capsys):
    answer = asked(capsys)
    assert answer["drsplat"] == version("drsplat")
    assert answer["packages"]["numpy"] == version("numpy")
    assert answer["native"] == {"instruction_sets": list(available_isas()), "chosen": default_isa()}
    assert answer["can"]["register, locate, render, train on the CPU"]["ready"]
    models = answer["can"][MODELS]
    assert models["ready"] == (has_torch and find_spec("transformers") is not None)
    assert models["ready"] or pip_install("models") in models["cure"]


@pytest.mark.parametrize("name", doctor.SERVERS)
def test_extras_that_are_missing_have_their_cure(installed, name):
    extra, modules = doctor.SERVERS[name]
    wanted = [one for one in requires("drsplat") or [] if f'extra == "{extra}"' in one]
    assert {re.split(r"[<>=;\s]", one)[0].replace("-", "_") for one in wanted} == set(modules)
    assert {module.replace("_", "-") for module in modules} <= set(doctor.PACKAGES)
    missing = doctor.abilities(FINE)[name]
    assert not missing["ready"]
    assert missing["reason"] == f"not installed: {', '.join(modules)}"
    assert missing["cure"] == pip_install(extra)
    installed.update(modules)
    assert doctor.abilities(FINE)[name]["ready"]


@pytest.mark.slow
@pytest.mark.skipif(not has_torch, reason="needs torch")
def test_torch_is_imported_by_another_process_only():
    code = "import sys; from drsplat.cli import main; main(['doctor']); print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("False\n")


def test_for_people(installed, capsys):
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert f"drsplat {version('drsplat')}" in out
    assert f"  yes {MODELS}\n" in out
    assert "laion/CLIP-ViT-B-16-laion2B-s34B-b88K: embeddings and words; " in out
    installed.remove("transformers")
    assert main(["doctor"]) == 0
    assert (
        f"  NO  {MODELS}\n      not installed: transformers\n      {pip_install('models')}\n" in capsys.readouterr().out
    )


def test_without_the_hub_nothing_is_known_of_models(installed, capsys):
    installed.discard("huggingface_hub")
    assert {of["cached"] for of in asked(capsys)["models"].values()} == {None}


def test_models_in_the_cache_are_found(installed, tmp_path, monkeypatch, capsys):
    pytest.importorskip("huggingface_hub", reason="needs huggingface_hub")
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    name = "facebook/sam2.1-hiera-tiny"
    assert not any(of["cached"] for of in asked(capsys)["models"].values())
    snapshot = tmp_path / f"models--{name.replace('/', '--')}" / "snapshots" / ("0" * 40)
    snapshot.mkdir(parents=True)
    (snapshot.parents[1] / "refs").mkdir()
    (snapshot.parents[1] / "refs" / "main").write_text("0" * 40)
    (snapshot / "config.json").write_text("{}")
    assert not asked(capsys)["models"][name]["cached"]  # without its weights
    (snapshot / "model.safetensors").write_text("")
    found = asked(capsys)["models"]
    assert [model for model, of in found.items() if of["cached"]] == [name]


def test_the_models_are_the_defaults():
    from drsplat.photos.models.loading import DEFAULT_ENCODER
    from drsplat.photos.models.sam import CPU_SEGMENTER, DEFAULT_SEGMENTER

    assert list(doctor.MODELS) == [DEFAULT_ENCODER, DEFAULT_SEGMENTER, CPU_SEGMENTER]


# --- what is broken ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("facts", "reason", "cure"),
    [
        ({}, None, None),
        ({"torch_fault": "OSError: libc10.so"}, "libc10.so", "--force-reinstall"),
        ({"torchvision_fault": "RuntimeError: nms"}, "RuntimeError: nms", "pip uninstall torchv"),
    ],
)
def test_faults_of_libraries(facts, reason, cure, installed):
    found = doctor.abilities({**FINE, **facts})[MODELS]
    assert found["ready"] == (reason is None)
    assert (reason or "") in (found["reason"] or "")
    assert (cure or "") in (found["cure"] or "")


def test_a_gpu_is_what_the_kernels_find(installed, monkeypatch):
    """CuPy's word, whatever torch finds."""
    monkeypatch.setattr("drsplat.kernels.cuda.engine.unavailable", lambda: "no GPU: buy one")
    found = doctor.abilities({**FINE, "cuda": ["NVIDIA X"]})[CUDA]
    assert (found["ready"], found["reason"]) == (False, "no GPU: buy one")
    assert doctor._gpus({**FINE, "cuda": ["NVIDIA X"]}) == ["NVIDIA X"]
    assert doctor._gpus({}) == []
    monkeypatch.setattr("drsplat.kernels.cuda.engine.unavailable", lambda: None)
    runtime = SimpleNamespace(getDeviceCount=lambda: 2, getDeviceProperties=lambda index: {"name": b"GPU %d" % index})
    monkeypatch.setitem(sys.modules, "cupy", SimpleNamespace(cuda=SimpleNamespace(runtime=runtime)))
    assert doctor.abilities({})[CUDA]["ready"]
    assert doctor._gpus({}) == ["GPU 0", "GPU 1"]


@pytest.mark.slow
@pytest.mark.skipif(not has_torch, reason="needs torch")
def test_a_broken_torchvision_is_found_by_importing_it(tmp_path, monkeypatch):
    (tmp_path / "torchvision").mkdir()
    (tmp_path / "torchvision" / "__init__.py").write_text("raise RuntimeError('no torchvision::nms')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    facts = doctor._probed()
    assert facts["torchvision_fault"] == "RuntimeError: no torchvision::nms"
    assert facts["torch_fault"] is None


def test_a_torch_that_cannot_be_imported(tmp_path, monkeypatch):
    (tmp_path / "torch.py").write_text("raise OSError('libc10.so: cannot open')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(doctor, "_is_installed", lambda name: True)
    facts = doctor._probed()
    assert facts["torch_fault"] == "OSError: libc10.so: cannot open"
    (tmp_path / "torch.py").write_text("import os; os._exit(3)")
    facts = doctor._probed()
    assert facts["torch_fault"] == "exit code 3"
    assert not doctor.abilities(facts)[MODELS]["ready"]


def test_without_torch_nothing_is_started(monkeypatch):
    monkeypatch.setattr(doctor, "_is_installed", lambda name: False)
    assert doctor._probed() == {}
    assert "not installed: torch, transformers" in doctor.abilities({})[MODELS]["reason"]
