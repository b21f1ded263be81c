"""The command line: parse, one call, print.

Every command has a public function that does its work, so that Python and the command line give the same files. What is
here turns arguments into the library's own options, and errors into one line.

main           the parser of all commands
words          numbers, poses and lists on the command line
terminal       what is printed, and where
render         `render`: clouds of a sensor or rig
outputs        the options of `render` that name files
ranging        `range` and `paper`, which trace nothing
field_of_view  `fov`
compare        `compare`
batch          `batch`
view           `view`
catalogue      `catalog` and `schema`
doctor         `doctor`: what runs on this machine
"""
