"""Streets made from a seed, or of a road network with SUMO's traffic: what stands, drives and walks there.

street_file     keys of [street]
centre_line     middle of a street: straights, clothoids and arcs, open or a loop; its hills
layout          what stands along a street, and its crossings
traffic         who drives and walks there, in place and time
street_tables   tables of a scene file for both, and the files of a scene
sumo            road networks, and what SUMO simulates on them
network_tables  tables of a scene file for a network
islands         islands between lanes, kerbs around the corners of junctions
polylines       ways along lines through points, and places beside them
terrain         heights of roads that climb, and of the soil around them
shapes          mesh, materials and scale of every body, and the districts that choose among them
pieces          poses, sheets of ground, soil and light, for both kinds of tables
"""

TOWN_STREETS = (3, 12)
"""Fewest and most streets of a drawn town in each direction."""
