"""What a scan pattern covers: how densely, how soon, how far.

Patterns of spinning, mirror and prism scanners are compared by what they see of a direction within a time, which data
sheets do not say.

study    sensors to pictures, CSV and a page
pattern  what a pattern covers, how densely and how soon
cells    cells of angle, and what has been hit
spacing  distances between neighbours
reach    how far a sensor sees, over its field and on the ground
seen     the questions of a study, and one sensor's answers
bodies   points on each body against its distance; this traces
figures  maps and charts
"""
