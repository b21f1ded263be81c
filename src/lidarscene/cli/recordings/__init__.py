"""Commands that read recordings of real lidars, and makers' files about a unit.

recording_options  `--frame` and `--metadata`; tells recordings from clouds
sensor             `sensor --from`
twin               `twin`
fit                `fit`
"""
