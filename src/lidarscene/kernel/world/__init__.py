"""Compile a scene into what the ray tracer asks: meshes, BSDFs and tables.

Mitsuba is fast with few shapes of many triangles and slow with many shapes, and it does not know bodies and classes. So
a scene is merged by material, and tables lead from a triangle back to its body.

build        `World`: a scene compiled for one wavelength
bsdfs        materials as Mitsuba BSDFs, and the retro-reflector
rough        the BSDF of rough matt surfaces
patterns     reflectivities that vary over a surface
speculars    at which surfaces a beam goes on
mitsuba_xml  shapes of Mitsuba XML scenes
triangles    the same as triangles, to draw
"""
