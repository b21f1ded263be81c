"""Triangles: mesh files and USD stages in any unit and axis, primitives, and reflectivity that varies over them.

reading                mesh files, by the readers below or trimesh
gltf                   glTF; gltf_document, what such a file declares, and its numbers
usd                    USD stages
polygons               polygons of any shape as triangles
mesh_axes              units and axes of files
mesh_cache             meshes kept as arrays between runs
reflectivity_patterns  reflectivity that varies over a mesh
primitives             planes, boxes and cylinders
"""
