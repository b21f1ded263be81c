"""Words of the makers' drivers for ROS 2: how they count rings, and what their launch files call topics and frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

DriverName = Literal["velodyne", "ouster", "hesai", "robosense", "livox"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Driver:
    """Words of one driver.

    Attributes:
        rings_rise: whether ring 0 is the lowest row; else rings are the channels, as the maker numbers them
        points: topic of the points
        frame: frame of the points, in which x points forward
        imu: topic of the IMU
        imu_frame: frame of the IMU
    """

    rings_rise: bool = True
    points: str
    frame: str
    imu: str = "imu"
    imu_frame: str = "imu"


DRIVERS: dict[str, Driver] = {
    # Without a maker: names of our own. Rings as Velodyne's, whose points most programs read.
    "": Driver(points="points", frame="lidar"),
    # ros-drivers/velodyne at c8239fb, VLP16-velodyne_driver_node-params.yaml; rings by rank of the elevation, as
    # velodyne_pointcloud's calibration has them.
    "velodyne": Driver(points="velodyne_points", frame="velodyne"),
    # ouster-lidar/ouster-ros at 0066d07, driver_params.yaml, with point_cloud_frame: os_sensor. In os_lidar, its
    # default, x points back to the plug. Rings are the rows of the scan, from the top.
    "ouster": Driver(rings_rise=False, points="ouster/points", frame="os_sensor", imu="ouster/imu", imu_frame="os_imu"),
    # HesaiTechnology/HesaiLidar_ROS_2.0 at 037ebdd, config.yaml; rings are the lasers of a packet, from 0
    # (HesaiLidar_SDK_2.0, setRing in the parser of each packet): from the top down but for the QTs.
    "hesai": Driver(rings_rise=False, points="lidar_points", frame="hesai_lidar", imu="lidar_imu"),
    # RoboSense-LiDAR/rslidar_sdk at 0d27b89, source_pointcloud_ros.hpp; rings by rank of the elevation (rs_driver,
    # ChanAngles::genUserChan).
    "robosense": Driver(points="rslidar_points", frame="rslidar", imu="rslidar_imu_data"),
    # Livox-SDK/livox_ros_driver2 at 0177b45, lddc.cpp; its "line" is the number of the laser.
    "livox": Driver(rings_rise=False, points="livox/lidar", frame="livox_frame", imu="livox/imu"),
}
"""Driver by name; "" for sensors of no maker."""
