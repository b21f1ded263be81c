"""The server, asked by another client than the browser."""

import json
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.served import Served, served
from helpers.small_scene import COARSE

import lidarscene
from lidarscene.cli.view import COMPILING
from lidarscene.view.blob import unpack_blob
from lidarscene.view.serve import HOST, Server

SETS = [f"--set={option}" for option in COARSE]


@pytest.fixture(scope="module")
def view(mi: Any, scene_file: Path) -> Iterator[Served]:
    with served(scene_file, *SETS, "--seed=5") as view:
        yield view


def test_a_live_scene_is_what_render_gives(view: Served, scene_file: Path) -> None:
    """Rationale: settings of the page and --set of `render` are two roads to one cloud, bit for bit."""
    status, page = view.get("")
    assert status == 200
    assert b"<canvas" in page
    stage, meshes = unpack_blob(view.get("stage")[1])
    assert stage["live"]
    assert stage["choices"]["detector"] == ["APD, its own", "SiPM of Table 1"]
    assert stage["choices"]["sensor"][0] == "table1-apd"
    assert len(meshes["faces"]) % 3 == 0
    for settings, sensor, sets in (
        ({}, "table1-apd", ()),
        (
            {"laser.peak_power_w": 5.0, "detector.gain": 33.0},
            "table1-apd",
            ("laser.peak_power_w=5.0", "detector.gain=33.0"),
        ),
        ({"detector": "SiPM of Table 1", "detector.pde": 0.1}, "table1-sipm", ("detector.pde=0.1",)),
    ):
        frame, arrays = unpack_blob(view.get("render", json.dumps(settings).encode())[1])
        cloud = lidarscene.render(scene_file, sensor, seed=5, overrides=[*COARSE, *sets])
        assert frame["count"] == len(cloud)
        np.testing.assert_array_equal(arrays["xyz"].reshape(-1, 3), cloud.xyz_m)
        np.testing.assert_array_equal(arrays["intensity"], cloud.intensity)
        np.testing.assert_array_equal(arrays["snr"], cloud.snr)
        explained = arrays["echo_power"] > 0
        np.testing.assert_array_equal(explained, np.isfinite(cloud.true_range_m))
    dark, _ = unpack_blob(view.get("render", b'{"sun.illuminance_klux": 0}')[1])
    assert dark["beams"] == 21 * 11


def test_what_it_refuses(view: Served) -> None:
    """Other hosts' names, other paths, and settings that are none: told in one line, and it goes on."""
    assert view.get("stage", Host="evil.example")[0] == 403
    assert view.get("render", b"{}", Host="evil.example")[0] == 403
    assert view.get("frame-1")[0] == 404
    assert view.get("../etc/passwd")[0] == 404
    assert view.get("stage", b"{}")[0] == 404
    for body, message in (
        (b"no", b"must be a JSON object"),
        (b"[1]", b"must be a JSON object"),
        (b'{"detector.gain": 0.1}', b"detector.gain: must be >= 1"),
        (b'{"detector": "\\ud800"}', b"\\ud800"),
        (b'{"sun.azimuth_deg": "west"}', b"sun.azimuth_deg: must be a number, got 'west'"),
    ):
        status, answer = view.get("render", body)
        assert status == 400
        assert message in answer
        assert b"\n" not in answer
    assert view.get("render", b"{}", **{"Content-Length": "x"})[0] == 400
    assert view.get("frame-0")[0] == 200


def test_ctrl_c_ends_it(mi: Any, scene_file: Path) -> None:
    """And a page that was closed, which resets its connection, leaves no trace in the terminal. Where starting takes
    more than a second, a line has said so.
    """
    with served(scene_file, *SETS) as view:
        assert view.get("")[0] == 200
        with socket.create_connection((HOST, urlsplit(view.url).port)) as closed:
            closed.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        assert view.get("stage")[0] == 200
        code, out, err = view.interrupt()
    assert (code, out) == (0, "ended\n")
    assert err in ("", f"lidarscene: {COMPILING}\n")


def test_only_this_machine_hears_it() -> None:
    with Server(0) as server:
        assert server.server_address[0] == HOST == "127.0.0.1"


def test_a_busy_port_is_one_line() -> None:
    with socket.socket() as listener:
        listener.bind((HOST, 0))
        listener.listen()
        port = listener.getsockname()[1]
        with told(f"port {port} | 0"):
            Server(port)
