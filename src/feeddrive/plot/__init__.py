"""Charts, figures and DataFrames of results; `Result.chart()`, `.plot()` and `.to_pandas()` find them by type.

A chart is a value (`chart.py`): `bode_chart(response)` gives what the figure `bode(response)` shows, and `drawn` draws
any chart with matplotlib's object API: a figure that shows itself in a notebook and writes itself with `savefig`.
Importing this package does not import matplotlib or pandas, nor the modules of the charts.
"""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
