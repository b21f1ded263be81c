"""What real lidars recorded: files of makers, data sets and ROS in, one sweep for each frame out.

sweep      one frame, pulse by pulse
recording  the frames of a file
opening    `open_recording`: the reader by the file's name
ouster     pcap with json, and OSF
"""
