"""What real lidars recorded: files of makers, data sets and ROS in, one sweep for each frame out.

sweep      one frame, pulse by pulse
recording  the frames of a file
opening    `open_recording`: the reader by the file's name
ouster     pcap with json, and OSF
velodyne   packets
hesai      packets
pandar64   packets of that one
packets    of a pcap file, and turns among them
bags       ROS 2 bags
clouds     KITTI, nuScenes, PCD, PLY, LAS
columns    a list of points by the names of its columns
as_cloud   a sweep as `PointCloud`
"""
