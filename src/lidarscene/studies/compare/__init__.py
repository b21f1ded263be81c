"""Compare what different sensors make of one scene.

Clouds of two sensors differ by chance alone. Frames are repeated with other seeds, and every number comes with an
interval, so that a difference can be told from noise.

study    from scenes, sensors or clouds to all files of the report
run      sensors on a scene, simulated
clouds   clouds that exist already
numbers  rates, errors and intervals
data     what each sensor made of its pulses
figures  charts
as_json  the numbers as JSON
page     the report as files
report   the comparison in words and tables
"""
