"""The report of a study: one self-contained HTML page. `build(study)` returns its text."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
