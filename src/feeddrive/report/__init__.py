"""Reports: a value of verdict, pictures, tables and texts, and its writer. `html(report)` returns a page."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
