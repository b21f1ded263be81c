"""Compare different sensors on one scene.

Clouds of two sensors differ by chance alone. All sensors get the same seed, pulses are matched one by one where both
sensors fire the same ones, and every number comes with a 95 % interval, so that a difference stands out from noise.

comparison_study       entry points: from a scene and sensors, or from clouds, to all files of the report
bench                  simulated observations of one scene
cloud_matching         observations from clouds that exist already
observations           what each sensor reported and missed, and how pulses are grouped
comparison_statistics  rates, range errors and their intervals
illuminance_sweep      rates over the illuminance, and where sensors change places
comparison_report      verdict, sentences and tables
comparison_figures     charts and their CSV
comparison_files       page, JSON, CSV, pictures and difference clouds on disk
"""
