"""Packets of pcap files, and turns."""

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.recordings import pcap

from lidarscene.recordings.packets import packets_of, turns_of


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_payloads_and_times_of_both_orders_and_clocks(tmp_path: Path, order: str, nanoseconds: bool) -> None:
    path = pcap(tmp_path / "a.pcap", [b"first", b"second"], order=order, nanoseconds=nanoseconds)
    packets = packets_of(path)
    assert [one.payload for one in packets] == [b"first", b"second"]
    assert packets[1].stamp_s == pytest.approx(100.001, abs=1e-9)
    assert [one.payload for one in packets_of(path, lambda payload: payload != b"first")] == [b"second"]


def test_what_is_damaged_is_told(tmp_path: Path) -> None:
    path = pcap(tmp_path / "a.pcap", [b"first", b"second"])
    whole = path.read_bytes()
    for size in (len(whole) - 1, len(whole) - 49, 24 + 7):
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match=r"truncated: it ends within packet [12]"):
            packets_of(path)
    for start, told in ((b"\x0a\x0d\x0d\x0a", "got a pcapng"), (b"none", "its first bytes are of none")):
        path.write_bytes(start + whole[4:])
        with pytest.raises(ValueError, match=told):
            packets_of(path)


def test_a_turn_ends_where_the_recording_began() -> None:
    for sign in (1, -1):
        azimuths = [(35_000 + sign * 1000 * number) % 36_000 for number in range(80)]
        assert turns_of(azimuths) == [slice(0, 36), slice(36, 72), slice(72, 80)]
    assert turns_of([]) == []
    assert turns_of([100]) == [slice(0, 1)]


MEMORY = """
import json, sys, tracemalloc
from lidarscene.recordings.packets import packets_of
# Before Python 3.12.9 and 3.13.2 tracemalloc can end a process in which Dr.Jit starts threads.
assert "drjit" not in sys.modules
tracemalloc.start()
packets = packets_of({path!r})
turn = packets.where(lambda payload: payload[0] != 7)[100:150]
payload = turn[3].payload
_, peak = tracemalloc.get_traced_memory()
print(json.dumps([len(packets), len(turn), payload[0], len(payload), peak]))
"""


def test_packets_stay_in_the_file(tmp_path: Path, run_python: Any) -> None:
    """Rationale: a drive is larger than memory. Of 5 MB of packets 24 bytes each are held, and what is asked for."""
    path = pcap(tmp_path / "a.pcap", [bytes([number % 256]) * 1200 for number in range(4000)])
    done = run_python(MEMORY.format(path=str(path)))
    assert done.returncode == 0, done.stderr
    *read, peak = json.loads(done.stdout)
    assert read == [4000, 50, 104, 1200]
    assert peak < 1e6
