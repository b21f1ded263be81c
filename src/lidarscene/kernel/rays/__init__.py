"""Trace the rays of a frame, from the sensor to the columns of its points.

A beam may go on through panes and gaps and off mirrors, among bodies that move. Each module answers one question about
a ray; `trace` asks them in order.

trace             the surface at the end of each path of a beam
meeting           the nearest surface among bodies that move
nearby_bodies     rays that come near moving bodies
onward            the path beyond a pane, gap or mirror
gaps              rays that pass a porous surface
glints            specular returns into the receiver
kept_lanes        lanes that have a return
point_columns     columns of the kept points, off the device
retraced_light    the light of chosen pulses, traced again
camera_distances  distances of the surfaces that a camera sees
"""
