"""Plugin of pytest: a worker of xdist that dies ends the run."""

import pytest


@pytest.hookimpl(trylast=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """End the run with its summary once a test is reported to have ended its worker.

    xdist reports these alone with "???". By itself it starts another worker, which has hung, or with
    --max-worker-restart=0 goes on with all that the other workers hold: minutes, where whole files are handed out.
    """
    if str(report.when) == "???":
        pytest.exit(str(report.longrepr), returncode=pytest.ExitCode.TESTS_FAILED)
