"""Light on its way: pulse, beam, surfaces, air, receiver, sun.

The link budget is a product of factors, and each factor is one module: what the laser sends, what a surface returns,
what the air and the receiver leave of it, and how much sunlight comes with it.

pulse           shape of the laser pulse in time
beam            divergence and beam quality
radiometry      the lidar equation
reflection      rough matt surfaces
dielectrics     Fresnel, panes, absorption, wet surfaces
glint           specular return of a flat pane or mirror
air             extinction of clear air and haze
receiver        overlap of spot and field of view
lens_scatter    stray light between channels
sunlight        irradiance in band
solar_spectrum  standard spectra, illuminance, filters
"""
