"""Packets over UDP in real time, as a sensor sends them while the world moves.

pacing   `Pacer`: sends each packet at its time, and late ones faster
sending  `send_frames`: frames rendered ahead in one thread, sent in another
"""
