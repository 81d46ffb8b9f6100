"""`pytest --last-skipped` runs what the last whole run skipped, and nothing else."""

import os
import subprocess
import sys

import pytest

from places import IMPORTED

CONFTEST = """
import last_skipped

def pytest_addoption(parser):
    last_skipped.add_option(parser)

def pytest_configure(config):
    last_skipped.register(config, whole_suite=not config.option.file_or_dir)
"""
HALF_SKIPPED = (
    "import os, pytest\ndef test_runs(): pass\ndef test_waits():\n    if 'EXTRA' not in os.environ: pytest.skip()"
)
SKIPPED_WHOLE = (
    "import os, pytest\nif 'EXTRA' not in os.environ: pytest.skip(allow_module_level=True)\ndef test_a(): pass"
)

NEVER_SKIPPED = "open('imported.txt', 'a').close()\ndef test_runs(): pass"


@pytest.mark.slow
@pytest.mark.parametrize("processes", [0, 1])
def test_last_skipped_runs_what_was_skipped(tmp_path, processes):
    texts = {
        "conftest": CONFTEST, "test_half": HALF_SKIPPED, "test_whole": SKIPPED_WHOLE, "test_fine": NEVER_SKIPPED,
    }  # fmt: skip
    for name, text in texts.items():
        (tmp_path / f"{name}.py").write_text(text)

    def summary(*arguments: str, **environment: str) -> str:
        command = [sys.executable, "-m", "pytest", f"-n{processes}", *arguments]
        paths = os.pathsep.join([IMPORTED, os.environ.get("PYTHONPATH", "")])
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": paths, **environment},
            capture_output=True,
            text=True,
        )
        return (done.stdout + done.stderr).strip().splitlines()[-1]

    assert "no run is recorded" in summary("--last-skipped")
    assert "2 passed, 2 skipped" in summary()
    assert "1 passed" in summary("test_half.py")  # a part of the suite, which is not recorded
    (tmp_path / "imported.txt").unlink()
    for _ in range(2):  # the record stays
        after_install = summary("--last-skipped", EXTRA="1")
        assert "2 passed" in after_install
        assert "skipped" not in after_install
    assert not (tmp_path / "imported.txt").exists()
