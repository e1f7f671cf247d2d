"""Forces on the table as functions of time."""
