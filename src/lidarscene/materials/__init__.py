"""Materials: reflection of surfaces by wavelength.

A material is data with a source for every number: kind of BSDF, spectra, parameters. `kernel.world.bsdfs` turns it into
a BSDF at the laser's wavelength.

material       `Material`
material_file  material files, materials inside scene files, and the catalogue's by name
colour         reflectivity from a visible colour
"""
