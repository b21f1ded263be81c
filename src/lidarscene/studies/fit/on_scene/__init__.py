"""Fit with a scene: a recording before surfaces whose places are known, of a twin or of any scene and poses.

pulses_on_scene   recorded pulses matched to the light of the scene
known_scene       prediction of what the sensor reports of each pulse
likelihood        maximum likelihood of the parameters, by exact slopes, reflectivities profiled out
scene_fit         all of these for one recording, with its report
"""
