"""Part programs in RS-274/NGC: their lines, words and expressions, their modes, their moves."""
