"""Packets: a frame pulse by pulse in, the UDP packets of the maker's own sensor out.

Lost pulses are in them, as zeros, in the order in which the lasers fire; so drivers, viewers and recorders of the real
sensor read the simulated one.

firings           a frame as arrays of firings by lasers
layouts           byte layouts of the makers' packets, for the encoders here and the readers in `recordings`
packet_encoder    protocol of an encoder, and what all encoders share
velodyne_encoder  VLP-16, HDL-32E and VLS-128
ouster_encoder    OS0, OS1 and OS2, in several profiles
pandar64_encoder  Hesai Pandar64
select_encoder    the encoder of a sensor
pcap              pcap files of packets
"""
