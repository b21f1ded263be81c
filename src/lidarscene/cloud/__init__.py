"""Point clouds: the result of a frame.

A cloud is a struct of arrays with one table of columns (`formats.cloud_columns`) for files, pictures and documentation.
It is read-only, and checked once when it is made. What is done with clouds stands here; file formats stand below, and
take whatever has a cloud's columns.

point_cloud  `PointCloud`
builder      a cloud out of chunks
rig_clouds   the clouds of a rig as one
deskew       remove the sensor's own motion
pixels       which point each pixel shows
thinning     as many points of a frame as a picture can show
interop      pandas, PyTorch, Open3D and notebooks
"""
