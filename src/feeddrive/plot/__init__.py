"""Figures and DataFrames of results; `Result.plot()` and `.to_pandas()` find them in `registry.py` by type.

A picture is drawn with matplotlib's object API: a figure that shows itself in a notebook and writes itself with
`savefig`.  Importing this package does not import matplotlib or pandas, nor the modules that draw.
"""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
