"""Recordings of real lidars: files of makers, data sets and ROS in, one sweep for each frame out.

sweep               one frame, pulse by pulse
recording           the frames of a file
opening             `open_recording`: the reader by the file's name
pcap_reader         UDP packets of a pcap file, and the turns among them
ouster_reader       Ouster: pcap with json, and OSF
velodyne_reader     Velodyne: packets of pcap files and ROS bags
hesai_reader        Hesai's spinning sensors: packets of pcap files and ROS bags
bags                ROS 2 bags
point_files         KITTI, nuScenes, PCD, PLY, LAS
sweep_from_columns  sweep of a list of points with named columns
as_cloud            a sweep as `PointCloud`
units/              sensor files of single units, from the makers' descriptions
"""
