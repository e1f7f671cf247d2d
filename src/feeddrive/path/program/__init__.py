"""Part programs in RS-274/NGC: lines, words and expressions, modes, and moves."""
