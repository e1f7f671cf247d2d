"""Floor 4, artefacts: files, plots and reports."""
