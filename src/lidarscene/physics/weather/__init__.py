"""Fog, rain and snow.

What floats or falls takes light from an echo and sends some of its own. Fog is a medium; a drop or flake in the beam is
a target of its own. Both come from size distributions and scattering theory, with sources.

fog            fog: sizes of droplets, extinction, backscatter
precipitation  rain and snow: sizes, extinction, backscatter
particles      the strongest drops and flakes in a beam
glory          what small drops send back as spheres, into a lens
mie            Mie scattering of a sphere
soft_target    the echo of a target without a surface
"""
