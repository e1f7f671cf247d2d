"""A P-PI design as the makers of controls see it: its quantities, its drive train, and what it has beside them."""
