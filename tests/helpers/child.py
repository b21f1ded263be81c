"""What a process that a test has started left behind."""

import subprocess

FEW_PLUGINS = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_PLUGINS": "xdist.plugin,pytest_timeout"}
"""Environment of a pytest in a process of its own: to import all others that are installed takes it a second."""


def assert_ended(
    process: subprocess.CompletedProcess[str], code: int = 0, *, stdout: str | None = None, stderr: str | None = ""
) -> None:
    """Fail with all that it wrote, unless it ended with this exit code and this output; None: whatever it wrote."""
    as_expected = process.returncode == code and stdout in (None, process.stdout) and stderr in (None, process.stderr)
    assert as_expected, f"exit code {process.returncode}\n{process.stdout}\n--- standard error\n{process.stderr}"
