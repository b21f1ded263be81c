"""Pictures of a real recording, not in the repository: `RECORDING=os2.pcap python docs/images/make.py twin fit`.

The documentation's are of `OS-2-128-U1_v2.3.0_1024x10.pcap`, with its json beside it, from ouster-sdk's tests (BSD-3).
"""

import os
import tempfile
from pathlib import Path

from drawing import WIDTH, below, store
from PIL import Image

from lidarscene.recordings.opening import open_recording
from lidarscene.studies.fit.recording_fit import fit_recordings
from lidarscene.studies.twin.certificate import REAL, SIMULATED, certify_in_twin
from lidarscene.studies.twin.twin_files import COLUMNS, SCENE, build_twin, choose_frames

SENSOR = "os2-128"


def recording() -> Path | None:
    """The file that was named, or None."""
    named = os.environ.get("RECORDING")
    return Path(named) if named else None


def twin() -> None:
    """A street as it was recorded, and as it is simulated in the twin of every second column."""
    path = recording()
    if path is None:
        return
    with tempfile.TemporaryDirectory() as folder:
        made, judged = Path(folder) / "twin", Path(folder) / "judged"
        with open_recording(path) as opened:
            build_twin(opened, choose_frames(opened, None, COLUMNS), made)
            certify_in_twin(made / SCENE, opened).save(judged)
        below([Image.open(judged / f"{name}.png").convert("RGB") for name in (REAL, SIMULATED)], "twin.png")


def fit() -> None:
    """The near field that `fit` found."""
    path = recording()
    if path is None:
        return
    with tempfile.TemporaryDirectory() as folder:
        fit_recordings([path], SENSOR)[1].save(Path(folder) / "report")
        store(Image.open(Path(folder) / "report" / "near-field.png").convert("RGB"), "fit.png", width=WIDTH)
