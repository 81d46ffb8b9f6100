"""drsplat doctor: what is installed, what can run here, what is missing."""

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
from .tables import show_facts, show_table

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
_PROBE = "import json; from drsplat.photos.models.probing import torch_facts; print(json.dumps(torch_facts()))"
_PROBE_S = 120


CACHE_TEXTS = {
    True: "in the local cache", False: "not in the local cache, downloaded at first use",
    None: "huggingface_hub is not installed",
}  # fmt: skip


@declaration
class Options(Verb):
    """Options of this verb: none of its own."""


def run(_: Options) -> Facts:
    from ...kernels import available_isas, default_isa
    from ...photos.models.devices import has_fast_bfloat16
    from ...photos.models.pretrained import cached_in_full

    has_hub, facts = _is_installed("huggingface_hub"), _probed()
    return {
        "drsplat": _version("drsplat"),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "packages": {name: _version(name) for name in PACKAGES},
        "native": {"instruction_sets": available_isas(), "chosen": default_isa()},
        "models": {
            name: {"for": use, "cached": cached_in_full(name) if has_hub else None} for name, use in MODELS.items()
        },
        "devices": {
            "cpu_cores": os.cpu_count(),
            "cpu_bfloat16": has_fast_bfloat16(),
            "cuda": _gpus(facts),
            "mps": facts.get("mps", False),
        },
        "can": abilities(facts),
    }


def show(answer: Facts) -> None:
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

    facts: as `torch_facts` gives them; empty where torch is not installed.
    """
    from ...kernels.cuda.engine import unavailable

    reasons = {
        "register, locate, render, train on the CPU": (None, None),
        "train, register, render on a CUDA GPU": (unavailable(), None),
        "masks and embeddings of real models (SAM, CLIP)": _no_models(facts),
        **{name: _no_extra(*needed) for name, needed in SERVERS.items()},
    }
    return {name: {"ready": reason is None, "reason": reason, "cure": cure} for name, (reason, cure) in reasons.items()}


def _no_extra(extra: str, modules: tuple[str, ...]) -> tuple[str | None, str | None]:
    absent = [name for name in modules if not _is_installed(name)]
    return (f"not installed: {', '.join(absent)}", pip_install(extra)) if absent else (None, None)


def _gpus(facts: Facts) -> list[str]:
    """Return the CUDA GPUs that torch finds, or else CuPy."""
    from ...kernels.cuda.engine import unavailable

    if facts.get("cuda") or unavailable() is not None:
        return list(facts.get("cuda", []))
    runtime = import_module("cupy").cuda.runtime
    return [runtime.getDeviceProperties(index)["name"].decode() for index in range(runtime.getDeviceCount())]


def _no_models(facts: Facts) -> tuple[str | None, str | None]:
    """Return why SAM and CLIP cannot run, and the cure."""
    from ...photos.models.libraries import NO_TORCHVISION

    if facts.get("torch_fault"):
        return f"torch cannot be imported: {facts['torch_fault']}", f"{pip_install('models')} --force-reinstall"
    if facts.get("torchvision_fault"):
        return (
            "the installed torchvision does not fit torch, so transformers cannot import its models "
            f"({facts['torchvision_fault']})",
            f"{NO_TORCHVISION} (drsplat needs none), or install the one of this torch",
        )
    return _no_extra("models", ("torch", "transformers"))


def _probed() -> Facts:
    """Return what only importing torch can tell, which another process does; one that died says why in its last line.

    It is {} without torch.
    """
    if not _is_installed("torch"):
        return {}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=_PROBE_S, check=False
        )
    except subprocess.TimeoutExpired:
        return {"torch_fault": f"no answer in {_PROBE_S} s"}
    try:
        facts: Facts = json.loads((done.stdout.splitlines() or [""])[-1])
    except ValueError:
        facts = {"torch_fault": (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]}
    return facts


def _is_installed(name: str) -> bool:
    return find_spec(name) is not None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
