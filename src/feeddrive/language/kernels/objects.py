"""The arguments of a kernel as Python objects: where these have their contents, and the machine code that reads them.

Python takes twenty times as long to look at type, sizes and address of each array of a call.  So it passes the
addresses of the arguments; what is in records, and the numbers and arrays, is read and checked by a loop in machine
code over a description of the parameters, which then calls the kernel.  What does not fit is left to Python, which
converts it or says what is wrong.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from feeddrive.language.kernels.source import Type
from feeddrive.language.machine_code import MachineCode, machine_code, target

UNFIT = -1
"""The status of a call with an argument that is not exactly of the type of its parameter; no kernel returns it."""
FIRST = 3  # words of a call: addresses of the description and of the arguments, and 1 if Python has checked these
WORD = 8  # bytes
DTYPES: dict[str, np.dtype[Any]] = {
    "float": np.dtype(np.float64),
    "int": np.dtype(np.int64),
    "record": np.dtype(np.float64),
}

# of CPython: the header of an object ends with its type; then a float (of numpy, too) has its value, an int its sign
# and the number of its digits, of 30 bits, and a tuple its size, and somewhere behind it the addresses of its items
_TYPE = object.__basicsize__ - WORD
_VALUE = object.__basicsize__
_DIGITS = int.__basicsize__
_ITEMS = tuple.__basicsize__
# sign and number of digits are one signed number up to Python 3.11, and later the number times 8 plus 1 less the sign
_SIGNED = sys.version_info < (3, 12)
# PyArrayObject of NumPy 2: first cell, number of indices, address of the sizes, strides, base, dtype, flags
DATA = object.__basicsize__
_INDICES = DATA + WORD
SIZES = DATA + 2 * WORD
_DTYPE = DATA + 5 * WORD
_FLAGS = DATA + 6 * WORD
_CARRAY = 0x1 | 0x100 | 0x400  # in C order, aligned and writeable
WORD_AT = ctypes.c_size_t.from_address
_HALF_WORD_AT = ctypes.c_uint32.from_address

_FLOAT, _INT, _BOOL, _ARRAY = range(4)
_HEAD = 10  # words of the description before its records
_ROW = 4  # words for a record, and for a number or array

_READ = """
define i64 @feeddrive_read(ptr %memory) #0 {{
start:
  %d = load ptr, ptr %memory
  %checkedp = getelementptr i64, ptr %memory, i64 1
  %checkedw = load i64, ptr %checkedp
  %checked = icmp ne i64 %checkedw, 0
  %kernel = load ptr, ptr %d
  %recordsp = getelementptr i64, ptr %d, i64 1
  %records = load i64, ptr %recordsp
  %leavesp = getelementptr i64, ptr %d, i64 2
  %leaves = load i64, ptr %leavesp
  %firstp = getelementptr i64, ptr %d, i64 3
  %first = load i64, ptr %firstp
  %words = getelementptr i64, ptr %memory, i64 %first
  %arrayp = getelementptr i64, ptr %d, i64 4
  %array = load ptr, ptr %arrayp
  %floatp = getelementptr i64, ptr %d, i64 5
  %float = load ptr, ptr %floatp
  %intp = getelementptr i64, ptr %d, i64 6
  %int = load ptr, ptr %intp
  %truep = getelementptr i64, ptr %d, i64 7
  %true = load ptr, ptr %truep
  %falsep = getelementptr i64, ptr %d, i64 8
  %false = load ptr, ptr %falsep
  %doublep = getelementptr i64, ptr %d, i64 9
  %double = load ptr, ptr %doublep
  %rows = getelementptr i64, ptr %d, i64 {head}
  br label %next_record
next_record:
  %k = phi i64 [ 0, %start ], [ %k1, %copied ]
  %row = phi ptr [ %rows, %start ], [ %row1, %copied ]
  %any = icmp slt i64 %k, %records
  br i1 %any, label %record, label %next_leaf
record:
  %rsource = load i64, ptr %row
  %rtypep = getelementptr i64, ptr %row, i64 1
  %rtype = load ptr, ptr %rtypep
  %rintop = getelementptr i64, ptr %row, i64 2
  %rinto = load i64, ptr %rintop
  %rcountp = getelementptr i64, ptr %row, i64 3
  %rcount = load i64, ptr %rcountp
  %robjectp = getelementptr ptr, ptr %memory, i64 %rsource
  %robject = load ptr, ptr %robjectp
  %rclassp = getelementptr i8, ptr %robject, i64 {type}
  %rclass = load ptr, ptr %rclassp
  %rfits = icmp eq ptr %rclass, %rtype
  br i1 %rfits, label %sized, label %unfit
sized:
  %rsizep = getelementptr i8, ptr %robject, i64 {value}
  %rsize = load i64, ptr %rsizep
  %rwhole = icmp eq i64 %rsize, %rcount
  %items = getelementptr i8, ptr %robject, i64 {items}
  %into = getelementptr ptr, ptr %memory, i64 %rinto
  br i1 %rwhole, label %copy, label %unfit
copy:
  %i = phi i64 [ 0, %sized ], [ %i1, %copying ]
  %more = icmp slt i64 %i, %rcount
  br i1 %more, label %copying, label %copied
copying:
  %itemp = getelementptr ptr, ptr %items, i64 %i
  %item = load ptr, ptr %itemp
  %placep = getelementptr ptr, ptr %into, i64 %i
  store ptr %item, ptr %placep
  %i1 = add i64 %i, 1
  br label %copy
copied:
  %k1 = add i64 %k, 1
  %row1 = getelementptr i64, ptr %row, i64 {row}
  br label %next_record
next_leaf:
  %m = phi i64 [ 0, %next_record ], [ %m1, %read ]
  %leaf = phi ptr [ %row, %next_record ], [ %leaf1, %read ]
  %left = icmp slt i64 %m, %leaves
  br i1 %left, label %look, label %call
look:
  %source = load i64, ptr %leaf
  %kindp = getelementptr i64, ptr %leaf, i64 1
  %kind = load i64, ptr %kindp
  %wantedp = getelementptr i64, ptr %leaf, i64 2
  %wanted = load ptr, ptr %wantedp
  %shapep = getelementptr i64, ptr %leaf, i64 3
  %shape = load i64, ptr %shapep
  %objectp = getelementptr ptr, ptr %memory, i64 %source
  %object = load ptr, ptr %objectp
  %classp = getelementptr i8, ptr %object, i64 {type}
  %class = load ptr, ptr %classp
  %value = getelementptr i8, ptr %object, i64 {value}
  switch i64 %kind, label %is_array [ i64 0, label %is_float i64 1, label %is_int i64 2, label %is_bool ]
is_float:
  %of_python = icmp eq ptr %class, %float
  %of_numpy = icmp eq ptr %class, %double
  %floats = or i1 %of_python, %of_numpy
  br i1 %floats, label %read_float, label %unfit
read_float:
  %number = load i64, ptr %value
  br label %read
is_bool:
  %holds = icmp eq ptr %object, %true
  %fails = icmp eq ptr %object, %false
  %bool = or i1 %holds, %fails
  %truth = zext i1 %holds to i64
  br i1 %bool, label %read, label %unfit
is_int:
  %ints = icmp eq ptr %class, %int
  br i1 %ints, label %read_int, label %unfit
read_int:
  %size = load i64, ptr %value
  {size}
  %digits = getelementptr i8, ptr %object, i64 {digits}
  ; from 2^60 on a number may be beyond 64 bits, which Python looks at
  %short = icmp slt i64 %length, 3
  %three = icmp eq i64 %length, 3
  %known = and i1 %three, %checked
  %fitting = or i1 %short, %known
  br i1 %fitting, label %digit, label %unfit
digit:
  %n = phi i64 [ 0, %read_int ], [ %n1, %adding ]
  %sum = phi i64 [ 0, %read_int ], [ %sum1, %adding ]
  %again = icmp slt i64 %n, %length
  br i1 %again, label %adding, label %summed
adding:
  %partp = getelementptr i32, ptr %digits, i64 %n
  %part = load i32, ptr %partp
  %long = zext i32 %part to i64
  %by = mul i64 %n, 30
  %high = shl i64 %long, %by
  %sum1 = add i64 %sum, %high
  %n1 = add i64 %n, 1
  br label %digit
summed:
  %signed = mul i64 %sum, %sign
  br label %read
is_array:
  %address = ptrtoint ptr %object to i64
  br i1 %checked, label %read, label %is_exact
is_exact:
  %arrays = icmp eq ptr %class, %array
  br i1 %arrays, label %cells, label %unfit
cells:
  %dtypep = getelementptr i8, ptr %object, i64 {dtype}
  %dtype = load ptr, ptr %dtypep
  %flagsp = getelementptr i8, ptr %object, i64 {flags}
  %flags = load i32, ptr %flagsp
  %indicesp = getelementptr i8, ptr %object, i64 {indices}
  %indices = load i32, ptr %indicesp
  %number_of = zext i32 %indices to i64
  %width = lshr i64 %shape, 8
  %count = and i64 %shape, 255
  %same = icmp eq ptr %dtype, %wanted
  %carray = and i32 %flags, {carray}
  %all = icmp eq i32 %carray, {carray}
  %like = icmp eq i64 %number_of, %count
  %one = and i1 %same, %all
  %both = and i1 %one, %like
  %rows_of = icmp ne i64 %width, 0
  br i1 %both, label %indexed, label %unfit
indexed:
  br i1 %rows_of, label %columns, label %read
columns:
  %sizespp = getelementptr i8, ptr %object, i64 {sizes}
  %sizesp = load ptr, ptr %sizespp
  %lastp = getelementptr i64, ptr %sizesp, i64 %count
  %columnsp = getelementptr i64, ptr %lastp, i64 -1
  %columns_of = load i64, ptr %columnsp
  %wide = icmp eq i64 %columns_of, %width
  br i1 %wide, label %read, label %unfit
read:
  %word = phi i64 [ %number, %read_float ], [ %truth, %is_bool ], [ %signed, %summed ], [ %address, %is_array ],
    [ %address, %indexed ], [ %address, %columns ]
  %wordp = getelementptr i64, ptr %words, i64 %m
  store i64 %word, ptr %wordp
  %m1 = add i64 %m, 1
  %leaf1 = getelementptr i64, ptr %leaf, i64 {row}
  br label %next_leaf
call:
  %status = call i64 %kernel(ptr %words)
  ret i64 %status
unfit:
  ret i64 {unfit}
}}
attributes #0 = {{ nounwind "no-builtins" }}
"""
_SIGN_AND_LENGTH = """%negative = icmp slt i64 %size, 0
  %minus = sub i64 0, %size
  %length = select i1 %negative, i64 %minus, i64 %size
  %sign = select i1 %negative, i64 -1, i64 1"""
_TAG = """%length = lshr i64 %size, 3
  %low = and i64 %size, 3
  %sign = sub i64 1, %low"""


@lru_cache(maxsize=1)
def reader() -> tuple[MachineCode, int]:
    """Return the machine code of the loop, and its address; its only argument is the memory of a call.

    That holds the address of a `description`, 1 if Python has checked the arguments and 0 otherwise, the address of the
    tuple of the arguments, room for the addresses of what is in it and in records, and room for what the entry of the
    kernel reads, into which it also writes its results.
    """
    text = _READ.format(
        head=_HEAD,
        type=_TYPE,
        value=_VALUE,
        items=_ITEMS,
        row=_ROW,
        size=_SIGN_AND_LENGTH if _SIGNED else _TAG,
        digits=_DIGITS,
        dtype=_DTYPE,
        flags=_FLAGS,
        indices=_INDICES,
        sizes=SIZES,
        carray=_CARRAY,
        unfit=UNFIT,
    )
    name = "feeddrive_read"
    code = machine_code(f'target triple = "{target()[0]}"\n{text}', [name], effort=2, passes=("simplify_cfg",))
    return code, code.addresses[name]


def description(parameters: Sequence[Type], entry: int) -> tuple[ctypes.Array[ctypes.c_int64], int]:
    """Return the description of the parameters of a kernel with the address of its entry, and the index of the word of
    its memory from which on the entry reads them.
    """
    # the arguments are taken out of their tuple as the fields out of a record
    records, leaves, end = [FIRST - 1, id(tuple), FIRST, len(parameters)], list[int](), FIRST + len(parameters)

    def described(kind: Type, source: int) -> None:
        nonlocal end
        if kind.layout and not kind.dimensions:
            fields, into = list(kind.layout.fields.values()), end
            end += len(fields)
            records.extend((source, id(kind.layout.python), into, len(fields)))
            for k, field in enumerate(fields):
                described(field, into + k)
        elif kind.dimensions:
            indices = kind.dimensions + bool(kind.layout)
            leaves.extend((source, _ARRAY, id(DTYPES[kind.element]), indices | (kind.width if kind.layout else 0) << 8))
        else:
            leaves.extend((source, {"float": _FLOAT, "int": _INT, "bool": _BOOL}[kind.element], 0, 0))

    for place, kind in enumerate(parameters):
        described(kind, FIRST + place)
    types = [id(each) for each in (np.ndarray, float, int, True, False, np.float64)]
    head = [entry, len(records) // _ROW, len(leaves) // _ROW, end, *types]
    rows = [*head, *records, *leaves]
    return (ctypes.c_int64 * len(rows))(*rows), end


def check_layout() -> None:
    """Raise ImportError unless objects have what the machine code reads where it reads it."""
    probe, pair = np.zeros((2, 3)), (1.5, -(3 + (5 << 30)))
    if sys.implementation.name == "cpython" and sys.int_info.bits_per_digit == 30:
        at = id(probe)
        sizes, long, double = WORD_AT(at + SIZES).value, id(pair[1]), np.float64(2.5)
        sign_and_length = ctypes.c_int64.from_address(long + _VALUE).value
        found = (
            WORD_AT(at + DATA).value,
            WORD_AT(sizes).value,
            WORD_AT(sizes + WORD).value,
            WORD_AT(at + _TYPE).value,
            WORD_AT(at + _DTYPE).value,
            _HALF_WORD_AT(at + _INDICES).value,
            _HALF_WORD_AT(at + _FLAGS).value & _CARRAY,
            ctypes.c_double.from_address(id(pair[0]) + _VALUE).value,
            ctypes.c_double.from_address(id(double) + _VALUE).value,
            WORD_AT(id(pair) + _VALUE).value,
            WORD_AT(id(pair) + _ITEMS + WORD).value,
            sign_and_length,
            _HALF_WORD_AT(long + _DIGITS).value,
            _HALF_WORD_AT(long + _DIGITS + 4).value,
        )
        whole = -2 if _SIGNED else 2 << 3 | 2
        known = (probe.ctypes.data, *probe.shape, id(np.ndarray), id(probe.dtype), 2, _CARRAY)
        if found == (*known, 1.5, 2.5, 2, long, whole, 3, 5):
            return
    raise ImportError(
        f"feeddrive's kernels know the objects of CPython and the arrays of NumPy 2, not those of "
        f"{sys.implementation.name} {sys.version.split()[0]} with NumPy {np.__version__}: install these"
    )


check_layout()
