"""Encodings that need no library of their own.

csv       CSV files with a line of column names
ply       types of numbers in PLY files
png       PNG files
protobuf  Protocol Buffers on the wire
"""
