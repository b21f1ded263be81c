"""Read and write files of any content.

The parts that every reader and writer needs: output that appears whole or not at all, errors of one line that name file
and key, and optional packages that are imported when they are first needed, with a hint what to install.

atomic        output that appears whole or not at all
json_text     JSON of reports, without numbers that are not finite
toml          TOML files as checked models
overrides     values in place of those of a file
table_model   models of tables whose keys a dataclass declares
spool         rows stored on disk to be read again
cache_folder  folder of files kept between runs
inputs        checks of files before they are read
facts         a few facts of an object, for a prompt and a notebook
installed_llvm  LLVM of this Python environment, for Dr.Jit
attributes    attributes that an object lacks, with what does it
late_binding  functions of higher tiers that methods of lower ones call
optional      optional packages, or what to install
open3d        Open3D
trimesh       trimesh, imported so that Ctrl-C is heard
pvlib         pvlib: standard spectra, position of the sun
encodings/    CSV with a line of names, PNG, types of PLY, Protocol Buffers
"""
