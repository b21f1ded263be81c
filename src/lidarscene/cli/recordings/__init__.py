"""Commands that read what real lidars recorded, and what makers say of a unit.

options  `--frame` and `--metadata`, and what is a recording
sensor   `sensor --from`
twin     `twin`
fit      `fit`
"""
