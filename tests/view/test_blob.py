"""Blobs: what goes in comes out, aligned for the browser's typed arrays."""

import numpy as np
import pytest

from lidarscene.view.blob import TYPES, pack_blob, unpack_blob


def test_what_goes_in_comes_out() -> None:
    """The lengths leave the arrays after them off their alignment unless they are padded."""
    arrays = {f"{name}-{n}": np.arange(n, dtype=name) for name in TYPES for n in (0, 1, 3, 7)}
    blob = pack_blob({"name": "näme", "count": 3}, arrays)
    header, unpacked = unpack_blob(blob)
    assert header == {"name": "näme", "count": 3}
    assert unpacked.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(unpacked[name], array)
        assert unpacked[name].dtype == array.dtype
    assert int.from_bytes(blob[:4], "little") % 4 == 0
    assert len(blob) % 4 == 0


def test_what_the_page_cannot_read_is_refused() -> None:
    with pytest.raises(KeyError, match="float64"):
        pack_blob({}, {"x": np.zeros(3)})
    with pytest.raises(ValueError, match="JSON"):
        pack_blob({"bad": float("nan")}, {})
