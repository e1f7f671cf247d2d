"""Analysis of loops and signals: margins, sensitivity, stiffness, spectrum, stability, friction map."""
