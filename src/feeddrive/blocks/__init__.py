"""Floor 1, the blocks: one law a file, named as its paper names it. `families.py` says what each kind must answer."""
