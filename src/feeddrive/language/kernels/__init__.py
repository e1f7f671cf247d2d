"""Kernels: plain Python functions with loops over numbers and arrays, run as machine code to the interpreter's bits.

kernel.py       the decorator, a call from Python, and the same call as plain Python
source.py       the source of a kernel: its text, its types, the names that it uses
text.py         lines and blocks of LLVM text, and the checks between them
arithmetic.py   operations on numbers as LLVM text
records.py      records: making them, their fields, rows of arrays
names.py        variables, constants, fields
expressions.py  expressions: choices, arrays, calls
assignments.py  variables, cells and rows
statements.py   control flow; a kernel as a function
module.py       all kernels of a file as one LLVM module: its key, its text, its machine code
remainder.py    `//` and `%` of floats, in the language of kernels
elementary.py   sin, cos, tan, atan and atan2
plain.py        arrays in the interpreter
"""
