"""What there is to see: bodies, light, weather, and the files that describe them.

A `Scene` is plain data in metres and radians. Files are TOML, Mitsuba XML, meshes or what trimesh holds; each mistake
in one is one line that names file and key.

scene       `Scene`, `Body`, `Part`, `Sun`, `Sky`, `Air`
weather     fog, rain and snow as data
scene_file  `load_scene`
tables      the tables of a scene file
motion      motion in scene files
poses       trajectory files
meshes/     mesh files, USD and primitives
bare_mesh   a mesh file as a scene
foreign     scenes of trimesh and Mitsuba
"""
