"""A sensor that sends while the scene moves.

stream  packets over UDP
"""
