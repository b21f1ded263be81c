"""The command line: parse, one call, print.

Every command has a public function that does its work, so that Python and the command line give the same files. The
modules here turn arguments into the library's own options, and errors into one line.

main              the parser of all commands
options           arguments made of the options of the library
words             numbers, poses and lists on the command line
terminal          printed answers, errors, notes and progress
render            `render`: clouds of a sensor or rig
stream            `stream`: packets over UDP
ranging           `range` and `paper`, which trace nothing
fov               `fov`
compare           `compare`
batch             `batch`
view              `view`
catalog_commands  `catalog`, `schema` and `check`
recordings        `sensor`, `twin` and `fit`, which read recordings of real lidars
doctor            `doctor`: what runs on this machine
"""
