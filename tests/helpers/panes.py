"""Panes and mirrors, and how much a lossless pane reflects."""

import dataclasses

import numpy as np

from helpers import chain
from lidarscene.materials.material import Material, Spectrum
from lidarscene.maths.trajectory import Motion

MIDDLE = 4

INDEX = 1.5


def pane_material(name="pane", **parameters):
    values = {"index_n": INDEX, "index_k": 0.0} | parameters
    return Material(name=name, bsdf="glass", reflectivity=Spectrum.constant(0.08), parameters=values)


def mirror_material(name="mirror", reflectivity=0.9, **parameters):
    return Material(name=name, bsdf="mirror", reflectivity=Spectrum.constant(reflectivity), parameters=parameters)


MATERIALS = (pane_material(), mirror_material())


def pane(range_m, theta_deg=0.0, *, name="pane", material="pane", size_m=4.0, motion: Motion | None = None):
    body = chain.facing(range_m=range_m, theta_deg=theta_deg, size_m=size_m, material=material)
    return dataclasses.replace(body, name=name, motion=motion)


def both_sides(cosine, index=INDEX):
    """R of a lossless pane, written anew: Snell by angles, Fresnel by sines, the geometric series by 50 terms."""
    theta = np.arccos(cosine)
    if theta < 1e-6:
        r = ((index - 1.0) / (index + 1.0)) ** 2
    else:
        inside = np.arcsin(np.sin(theta) / index)
        r = 0.5 * (
            (np.sin(theta - inside) / np.sin(theta + inside)) ** 2
            + (np.tan(theta - inside) / np.tan(theta + inside)) ** 2
        )
    return r + (1 - r) ** 2 * sum(r ** (2 * k + 1) for k in range(50))
