"""Packets: a frame pulse by pulse in, what the maker's own sensor would send out.

Lost pulses are in it, as zeros, in the order in which the lasers fire; so drivers, viewers and recorders of the real
sensor read the simulated one.

firings   a frame as arrays of firings by lasers
velodyne  VLP-16, HDL-32E and VLS-128
ouster    OS0, OS1 and OS2, in several profiles
hesai     Pandar64
makers    the format of a sensor
pcap      captures
"""
