"""Kernels: plain Python functions with loops over numbers and arrays, run as machine code with bit-identical results.

kernel.py       the decorator, calls from Python, and the machine code of all kernels of a file
source.py       the source of a kernel: its text, its types, its names; arrays in the interpreter
text.py         lines, blocks and checks of LLVM text, and operations on numbers
llvm.py         records, names, expressions, assignments and statements as LLVM text
elementary.py   `//` and `%` of floats; sin, cos, tan, atan and atan2
"""
