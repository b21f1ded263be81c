"""Triangles: mesh files and USD stages in any unit and axis, primitives, and reflectivity that varies over them.

reading     mesh files, by trimesh
usd         USD stages
axes        units and axes of files
cache       meshes kept as arrays between runs
patterns    reflectivity that varies over a mesh
primitives  planes, boxes and cylinders
"""
