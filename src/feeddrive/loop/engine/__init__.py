"""The engine: compiles the graph of one sample to native code for the whole time loop.

lower.py      elementary functions and other composed operations become plain arithmetic
classify.py   what is constant over a run, and what differs between lanes
plan.py       the lowered graph with the order of everything in memory
lazy_branches.py  what only one branch of a choice needs
llvm.py       operations as LLVM text; lanes are vectors
time_loop.py  the loop around them, as an LLVM module
c.py          the same loop as C text
native.py     machine code, in memory and on disk
"""
