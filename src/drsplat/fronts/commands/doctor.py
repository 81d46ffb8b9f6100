"""drsplat doctor: what is installed, what can run here, what is missing."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from ...errors import pip_install
from .declaring import Facts, declaration
from .options import Verb

EXAMPLES = """\
  drsplat doctor
  drsplat doctor --json

Downloads nothing and needs no network."""

PACKAGES = {
    "numpy": "core", "scipy": "core", "pillow": "core", "safetensors": "core", "zstandard": "core",
    "rich": "core", "torch": "models", "transformers": "models",
    "huggingface_hub": "models", "sentencepiece": "words for SigLIP 1 and TIPSv2", "torchvision": "open-clip, EdgeTAM",
    "timm": "open-clip, EdgeTAM", "open_clip_torch": "open-clip",
    "cupy-cuda12x": "cuda", "cupy-cuda13x": "cuda13", "fastapi": "viewer, serve", "uvicorn": "viewer, serve",
    "prometheus-client": "viewer, serve, mcp", "mcp": "mcp", "faiss-cpu": "not needed",
    "pycolmap": "capture", "pi-heif": "capture", "av": "capture",
}  # fmt: skip
"""Name of each distribution and what it is for."""
SERVERS = {
    "pose photos and videos (drsplat capture)": ("capture", ("pycolmap", "pi_heif", "av")),
    "show and search scenes in a browser (drsplat view)": ("viewer", ("fastapi", "uvicorn", "prometheus_client")),
    "serve scenes over HTTP (drsplat serve)": ("serve", ("fastapi", "uvicorn", "prometheus_client")),
    "scenes for language models (drsplat mcp)": ("mcp", ("mcp", "prometheus_client")),
}
"""Features that need an extra, and its modules."""
MODELS = {
    "laion/CLIP-ViT-B-16-laion2B-s34B-b88K": "embeddings and words",
    "facebook/sam-vit-huge": "masks, on a GPU",
    "facebook/sam2.1-hiera-tiny": "masks, on a CPU",
}
"""The default models by id; written out because importing those who load them takes longer than all of this."""
_PROBE = "import json; from drsplat.fronts.commands.doctor import probe; print(json.dumps(probe()))"
_PROBE_S = 120


CACHE_TEXTS = {
    True: "in the local cache", False: "not in the local cache, downloaded at first use",
    None: "huggingface_hub is not installed",
}  # fmt: skip


@declaration
class Options(Verb):
    """Options of this verb: none of its own."""


def run(_: Options) -> Facts:
    from ...photos.models.devices import has_fast_bfloat16

    asked = _start_probe()  # the slowest: importing torch; the rest is done meanwhile
    versions = {name: _version(name) for name in PACKAGES}
    answer = {
        "drsplat": _version("drsplat"),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "packages": versions,
        "native": _native(),
        "models": _models(),
    }
    facts = _probed(asked)
    devices: Facts = {"cpu_cores": os.cpu_count(), "cpu_bfloat16": has_fast_bfloat16()}
    devices |= {"cuda": _gpus(facts), "mps": facts.get("mps", False)}
    return {**answer, "devices": devices, "can": abilities(facts)}


def show(answer: Facts) -> None:
    from .tables import show_facts, show_table

    native, devices = answer["native"], answer["devices"]
    show_facts(
        f"drsplat {answer['drsplat']}",
        {
            "Python": f"{answer['python']} on {answer['system']}",
            "instruction set": f"{native['chosen']} of {', '.join(native['instruction_sets'])}",
            "CPU": f"{devices['cpu_cores']} cores, bfloat16 {'fast' if devices['cpu_bfloat16'] else 'not in hardware'}",
            "GPU": ", ".join(devices["cuda"]) or ("Apple's" if devices["mps"] else "none found"),
        },
    )
    packages = answer["packages"].items()
    rows = [(name, number or "not installed", PACKAGES[name]) for name, number in packages]
    show_table("Packages", ("name", "version", "for"), rows)
    print("Models")  # lines, because a table would cut their ids, which people copy
    for name, of in answer["models"].items():
        print(f"  {name}: {of['for']}; {CACHE_TEXTS[of['cached']]}")
    print("\nWhat can run")
    for name, ability in answer["can"].items():
        print(f"  {'yes' if ability['ready'] else 'NO '} {name}")
        for line in (ability["reason"], ability["cure"]):
            if line:
                print(f"      {line}")


def abilities(facts: Facts) -> dict[str, Facts]:
    """Return what can run: ready, else the reason, and what to do about it.

    facts: as `probe` gives them; empty where torch is not installed.
    """
    return {
        "register, locate, render, train on the CPU": _ability(None, None),
        "train, register, render on a CUDA GPU": _ability(_no_cuda(), None),
        "masks and embeddings of real models (SAM, CLIP)": _ability(*_no_models(facts)),
        **{name: _ability(*_no_extra(*needed)) for name, needed in SERVERS.items()},
    }


def _no_extra(extra: str, modules: tuple[str, ...]) -> tuple[str | None, str | None]:
    absent = [name for name in modules if not _is_installed(name)]
    if not absent:
        return None, None
    return f"not installed: {', '.join(absent)}", pip_install(extra)


def _ability(reason: str | None, cure: str | None) -> Facts:
    return {"ready": reason is None, "reason": reason, "cure": cure}


def _no_cuda() -> str | None:
    """Return why our kernels run on no GPU here, and what to do; None where they do."""
    from ...kernels.cuda.engine import unavailable

    return unavailable()


def _gpus(facts: Facts) -> list[str]:
    """Return the CUDA GPUs that torch finds, or else CuPy."""
    if facts.get("cuda") or _no_cuda() is not None:
        return list(facts.get("cuda", []))
    runtime = import_module("cupy").cuda.runtime
    return [runtime.getDeviceProperties(index)["name"].decode() for index in range(runtime.getDeviceCount())]


def _no_models(facts: Facts) -> tuple[str | None, str | None]:
    """Return why SAM and CLIP cannot run, and the cure."""
    from ...photos.models.libraries import NO_TORCHVISION

    absent = [name for name in ("torch", "transformers") if not _is_installed(name)]
    if absent:
        return f"not installed: {', '.join(absent)}", pip_install("models")
    if facts.get("torch_fault"):
        return f"torch cannot be imported: {facts['torch_fault']}", f"{pip_install('models')} --force-reinstall"
    if facts.get("torchvision_fault"):
        return (
            "the installed torchvision does not fit torch, so transformers cannot import its models "
            f"({facts['torchvision_fault']})",
            f"{NO_TORCHVISION} (drsplat needs none), or install the one of this torch",
        )
    return None, None


def probe() -> Facts:
    """Return what only importing torch can tell."""
    from ...photos.models.probing import torch_facts

    return torch_facts()


def _start_probe() -> subprocess.Popen[str] | None:
    if not _is_installed("torch"):
        return None
    return subprocess.Popen([sys.executable, "-c", _PROBE], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _probed(asked: subprocess.Popen[str] | None) -> Facts:
    """Return the answer of a process, its last line; one that died says why in its own last line."""
    if asked is None:
        return {}
    try:
        out, errors = asked.communicate(timeout=_PROBE_S)
    except subprocess.TimeoutExpired:
        asked.kill()
        asked.communicate()
        out, errors = "", f"no answer in {_PROBE_S} s"
    try:
        facts = json.loads((out.splitlines() or [""])[-1])
    except ValueError:
        fault = (errors.strip().splitlines() or [f"exit code {asked.returncode}"])[-1]
        return {"torch_fault": fault}
    return facts if isinstance(facts, dict) else {}


def _native() -> Facts:
    from ...kernels import available_isas, default_isa

    return {"instruction_sets": list(available_isas()), "chosen": default_isa()}


def _models() -> dict[str, Facts]:
    """Return the purpose of each default model, and whether it is here (None: cannot be told), by id."""
    from ...photos.models.pretrained import cached_in_full

    known = _is_installed("huggingface_hub")
    return {name: {"for": use, "cached": cached_in_full(name) if known else None} for name, use in MODELS.items()}


def _is_installed(name: str) -> bool:
    return find_spec(name) is not None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
