"""Compile a scene into what the ray tracer asks: meshes, BSDFs and tables.

Mitsuba is fast with few shapes of many triangles and slow with many shapes, and it does not know bodies and classes. So
a scene is merged by material, and tables lead from a triangle back to its body.

mitsuba_world  `World`: a scene compiled for one wavelength
mover_scene    one scene of all bodies that move, each in a cell of its own
merged_meshes  shapes of a Mitsuba file, one mesh for each BSDF
bsdfs          materials as Mitsuba BSDFs and textures; the retro-reflector and rough matt surfaces
faces          tables from a hit's face to body, class, material and normal
speculars      surfaces at which a beam goes on
mitsuba_xml    shapes of Mitsuba XML scenes
xml_instances  instances in such a file, as shapes of their own
xml_bsdfs      BSDFs of such a file, replaced before Mitsuba loads it
triangles      shapes of such a file as triangles, to draw
"""
