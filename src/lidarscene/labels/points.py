"""Class and instance of each point, in SemanticKITTI's numbers.

A point knows the body that it is of; what data sets want is a number of a class and one of an instance. Whatever is no
echo is an outlier, so that a network learns what noise looks like.
"""

from __future__ import annotations

import numpy as np

from ..cloud.points import PointCloud
from ..maths.arrays import Numbers
from ..maths.trajectory import Course
from ..scene.model import Scene
from .boxes import Box as Box
from .boxes import box_of as box_of
from .boxes import boxes as boxes
from .boxes import sensor_place as sensor_place
from .boxes import truth_of
from .boxes import upright as upright
from .kinds import KINDS as KINDS
from .kinds import MOVING, OUTLIER, UNLABELLED
from .kinds import kind_of as kind_of


def point_labels(cloud: PointCloud, scene: Scene) -> tuple[Numbers, Numbers]:
    """(n,) SemanticKITTI number and (n,) instance of each point: body + 1 of a thing, else 0.

    What is no echo is an outlier, a point without a body unlabelled.
    """
    (_, body), class_id = truth_of(cloud), np.asarray(cloud.class_id)
    kinds = [kind_of(name) for name in cloud.class_names]
    # The last entry of each table is that of -1.
    numbers = np.array([*(kind.semantic_kitti for kind in kinds), UNLABELLED], np.uint32)
    things = np.array([*(kind.thing for kind in kinds), False])
    semantic, echo = numbers[class_id], cloud.status == 0
    for index, one in enumerate(scene.bodies):
        number = kind_of(one.class_name).semantic_kitti
        rests = one.motion is None or (isinstance(one.motion, Course) and one.motion.rests)
        if not rests and number in MOVING:
            semantic[body == index] = MOVING[number]
    instance = np.where(echo & things[class_id], body + 1, 0).astype(np.uint32)
    return np.where(echo, semantic, np.uint32(OUTLIER)), instance
