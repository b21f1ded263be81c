"""The command `stream`: the makers' own readers take what it sends, live, over the loopback."""

import itertools
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import Run

from lidarscene import render_frames
from lidarscene.sensor.sensor_file import load_sensor

FAST = ("--rate", "50")
"""Frames in a second: nothing is measured by the machine's clock here."""


class Listener:
    """Takes packets in a thread, from before the first is sent."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.2)
        self.address = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self.payloads: list[bytes] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen)

    def _listen(self) -> None:
        while True:
            try:
                self.payloads.append(self._socket.recv(70_000))
            except TimeoutError:
                if self._ended.is_set():
                    return

    def __enter__(self) -> "Listener":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()


def test_velodynes_reader_takes_the_stream(mi: Any, run: Run, wall: str, library: Callable[[str], Any]) -> None:
    """Its stream decoder gives a cloud for each turn, of as many points as `render` has."""
    velodyne = library("velodyne_decoder")
    with Listener() as listener:
        ran = run("stream", wall, "--sensor", "vlp-16", "--udp", listener.address, "--frames", "2", *FAST)
    assert ran.code == 0
    assert ran.out.startswith(f"vlp-16 in wall to {listener.address} (Ctrl-C ends)\nsent 2 frames, 151 packets;")
    assert len(listener.payloads) == -(-2 * 1808 // 24) == 151
    decoder = velodyne.StreamDecoder(velodyne.Config(max_range=400.0))
    stamps = [int.from_bytes(payload[1200:1204], "little") for payload in listener.payloads]
    assert np.abs((np.diff(stamps) % 3_600_000_000) - 1327.1).max() < 1.5
    scans = [decoder.decode(number * 1327e-6, payload) for number, payload in enumerate(listener.payloads)]
    scans = [scan for scan in [*scans, decoder.finish()] if scan is not None]
    assert len(scans) in (2, 3)  # it cuts where it began, a packet early or late
    # A packet has 16 bits for steps of 2 mm: a false alarm beyond 131.07 m does not fit.
    rendered = [int(np.count_nonzero(cloud.range_m < 131.07)) for cloud in render_frames(wall, "vlp-16", frames=2)]
    assert sum(len(points) for _, points in scans) == sum(rendered) > 1000


def test_ousters_own_client_takes_the_stream(mi: Any, run: Run, wall: str, library: Callable[[str], Any]) -> None:
    core, client = library("ouster.sdk.core"), library("ouster.sdk._bindings.client")
    with Listener() as listener:
        port = int(listener.address.partition(":")[2])
    arguments = ("--sensor", "os1-128", "--set", "scanner.columns_per_turn=512", "--metadata", "os1.json")
    ran = run("stream", wall, *arguments, "--udp", f"127.0.0.1:{port}", "--frames", "1", *FAST)
    assert ran.code == 0
    info = core.SensorInfo(Path("os1.json").read_text())
    assert info.config.udp_port_lidar == port
    core.init_logger("critical")
    source = client.SensorPacketSource([client.Sensor("127.0.0.1", info.config)], [info], 5.0, 0.0)
    batcher, frame, frames = core.FrameBatcher(info), core.LidarFrame(info), []
    ended = threading.Event()

    def listen() -> None:
        while not ended.is_set() or len(frames) < 2:
            event = source.get_packet(0.2)
            if event.type == client.ClientEventType.Packet:
                if batcher.batch(event.packet(), frame):
                    frames.append((frame.complete(), int((frame.field("RANGE") > 0).sum())))
            elif ended.is_set():
                return

    listening = threading.Thread(target=listen)
    listening.start()
    try:
        ran = run("stream", wall, *arguments, "--udp", f"127.0.0.1:{port}", "--frames", "2", *FAST)
    finally:
        ended.set()
        listening.join()
    assert ran.code == 0
    assert [is_complete for is_complete, _ in frames] == [True, True]
    assert min(points for _, points in frames) > 500


def test_ctrl_c_ends_it_as_it_ends_the_view(mi: Any, run: Run, wall: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once it sends: as many frames as wait, and one more."""
    from lidarscene.outputs.live import sending

    real = sending.render_firings

    def interrupted(*arguments: Any, **options: Any) -> Any:
        yield from itertools.islice(real(*arguments, **options), sending.AHEAD + 1)
        raise KeyboardInterrupt

    monkeypatch.setattr(sending, "render_firings", interrupted)
    with Listener() as listener:
        ran = run("stream", wall, "--sensor", "vlp-16", "--udp", listener.address, *FAST)
    assert (ran.code, "error" in ran.err) == (0, False)
    assert ran.out.splitlines()[-1].startswith("sent ")


def test_a_sensor_turns_as_often_as_its_frames_are_sent() -> None:
    """Rationale: real time is the default; a frame of VLP-16 is 1808 firings."""
    assert load_sensor("vlp-16").scanner.frame_s == pytest.approx(1808 * 55.296e-6)
