"""Scenes: bodies, light and weather, and the files that describe them.

A `Scene` is plain data in metres and radians. It is read from TOML, Mitsuba XML or mesh files, or made of a trimesh
object. A mistake in a file is reported in one line that names file and key.

scene       `Scene`, `Body`, `Part`, `Sun`, `Sky`, `Air`
weather     fog, rain and snow as data
scene_file  `load_scene`
tables      the tables of a scene file
motion      motion in scene files
poses       trajectory files
ground      ground that is not a plane, and its height
ride        vehicles that ride over rough ground
meshes/     mesh files, USD and primitives
bare_mesh   a mesh file as a scene
sizes       sizes of bodies, and vehicles of which they are odd
shared_faces  bodies with one and the same surface
foreign     scenes of trimesh and Mitsuba
saving      scene files of scenes
"""
