"""Loop shaping: any law with its filters on measured or modelled axes, by slopes that come from the law itself."""
