"""Points on bodies, of a cloud made by hand."""

import numpy as np
from helpers.clouds import small_cloud

from lidarscene.studies.field_of_view.body_points import BodyPoints, _points_by_body


def test_each_body_has_its_points_and_its_median_distance() -> None:
    """Five echoes: three on a far car, one on a near walker, one on a road without a class; and two false alarms of
    beams that meet the car, and a tree that no echo is of.
    """
    cloud = small_cloud(
        n=7,
        status=np.array([0, 0, 0, 0, 0, 1, 1], np.uint8),
        body=np.array([1, 0, 1, 2, 1, 1, 3], np.int32),
        class_id=np.array([0, -1, 0, 1, 0, 0, 0], np.int32),
        true_range_m=np.array([40.0, 5.0, 30.0, 12.0, 37.0, 35.0, 60.0], np.float32),
        body_names=("road", "car 1", "walker", "tree"),
        class_names=("car", "person"),
    )
    assert _points_by_body(cloud) == [
        BodyPoints(body="walker", label="person", distance_m=12.0, points=1),
        BodyPoints(body="car 1", label="car", distance_m=37.0, points=3),
    ]
