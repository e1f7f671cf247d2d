"""A control as Structured Text (IEC 61131-3), for PLCs: one function block, and the files that PLC tools import."""
