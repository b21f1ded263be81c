"""How surfaces reflect, by wavelength.

A material is data with a source for every number: kind of BSDF, spectra, parameters. `kernel.world.bsdfs` turns it into
a BSDF at the laser's wavelength.

material   `Material`
file       material files, and materials inside scene files
colour     what visible colours say of it
catalogue  the materials of the catalogue, by name
"""
