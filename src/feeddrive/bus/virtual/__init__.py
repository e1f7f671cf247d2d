"""A virtual drive: CiA 402 firmware around a simulated axis, on EtherCAT or CANopen."""
