"""Formulas that nothing in a render or a study runs: to compare with those that do.

What the paper and others print, in their own form, closed forms of special cases, and bounds. A change here changes no
point of a cloud. `tests/chain/test_formulas.py` holds that everything else in `physics` is run.

apd              noise and SNR of an avalanche photodiode, (12), (13), (18), (19)
sipm             SNR and probabilities of a silicon photomultiplier, (21), (26), (27), (S1) to (S3)
mcintyre         electrons of an avalanche, one by one; Webb's tail
electronics      comparator and clock, bounds of a pulse's time, an amplifier that clips
optics           flat Lambertian walls, (2) to (8); wet surfaces, points of light, spectra
photon_counting  Coates' correction, the bound of a pulse's time
surroundings     roads, rain, inertial sensors
"""
