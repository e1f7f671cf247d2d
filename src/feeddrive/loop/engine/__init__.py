"""The engine: compiles the graph of one sample to native code for the whole time loop.

plan.py   the graph in plain arithmetic, the memory layout, the values that are constant over a run or differ between
          lanes (variants that run side by side), and the operations that only one branch of a choice needs
llvm.py   operations and time loop as LLVM text, with lanes as vectors, and the machine code of a plan;
          `language/machine_code.py` compiles and caches it
"""
