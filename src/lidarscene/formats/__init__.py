"""File formats of point clouds, one module each.

A writer takes a `cloud_columns.Cloud`, a reader returns its fields as a dictionary: so formats stand below the class
`PointCloud`, which saves and loads through them. Formats that can be written piece by piece have
a stream whose bytes do not depend on how the cloud was cut.

cloud_columns      table of all columns, the data `Cloud` of a point cloud, and which points are of one pulse
category_array     codes that compare by their names
cloud_description  metadata and names as one line of JSON; errors of reading and writing
registry           formats by name and suffix
ply                PLY
pcd                PCD of the Point Cloud Library
las                LAS and LAZ
e57                E57
npz                NumPy archives
parquet            Apache Parquet
kitti              KITTI and nuScenes
ros                ROS 2 bags
osi                ASAM OSI
motion_files       samples of IMUs, and poses
clock              dates of stamps
packets/           UDP packets as the makers' sensors send them
"""
