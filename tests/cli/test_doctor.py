"""Doctor: the report names everything a bug report needs, and never fails itself."""

import platform

from lidarscene.cli.doctor import examine
from lidarscene.kernel.device import backend


def test_a_healthy_machine(mi) -> None:
    findings = examine()
    text = findings.as_text()
    assert findings.healthy
    assert platform.python_version() in text
    assert mi.__version__ in text
    assert mi.variant() in text
    assert "plate at 5.0000 m, range found 5.0000 m: right" in text
    assert text.endswith("lidarscene can trace rays here")


def test_a_back_end_that_fails_at_work(mi, monkeypatch) -> None:
    def fail() -> tuple[float, float]:
        raise RuntimeError("no OptiX")

    monkeypatch.setattr(backend, "trace_one_ray", fail)
    findings = examine()
    assert not findings.healthy
    assert "failed: no OptiX" in findings.as_text()


def test_a_back_end_that_is_wrong(mi, monkeypatch) -> None:
    monkeypatch.setattr(backend, "trace_one_ray", lambda: (5.0, 4.0))
    findings = examine()
    assert not findings.healthy
    assert "WRONG" in findings.as_text()


def test_doctor_does_not_import_what_it_names(run_python) -> None:
    process = run_python(
        "import sys; from lidarscene.cli.doctor import examine; examine(); print('open3d' in sys.modules)"
    )
    assert process.stdout.strip() == "False"
