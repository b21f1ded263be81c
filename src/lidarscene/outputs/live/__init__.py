"""A sensor that sends while the world moves: packets over UDP, in real time.

pacing   when each packet is due, and what is done when it is late
sending  frames computed ahead, in the order in which they are sent
"""
