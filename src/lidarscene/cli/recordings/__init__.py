"""Commands that read recordings of real lidars, and makers' files about a unit.

recording_options  `--frame`, `--metadata` and `--sensor-index`; the test whether a file is a recording
sensor             `sensor --from`
twin               `twin`
fit                `fit`
certify            `certify`
"""
