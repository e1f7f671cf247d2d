"""A drive that does not exist: the firmware of CiA 402 around a simulated axis, on EtherCAT or CANopen."""
