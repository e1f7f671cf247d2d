"""The engine: from the graph of one sample to native code for the whole time loop.

lower.py      elementary functions and other composed operations become plain arithmetic
classify.py   what is constant over a run, and what differs between lanes
llvm.py       the graph as LLVM text; lanes are vectors
c.py          the same graph as C text
native.py     machine code, in memory and on disk
"""
