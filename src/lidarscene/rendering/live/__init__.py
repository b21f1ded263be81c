"""A world that the caller moves: bodies placed, added and taken away between frames, by his clock or the scene's.

simulator  `LiveSimulator`
bodies     which bodies of a scene can be placed, and the spare ones
tracks     motions through the poses that were given so far
"""
