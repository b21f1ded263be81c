"""Scene files and meshes in; clouds out, one module per format. Import the modules themselves."""
