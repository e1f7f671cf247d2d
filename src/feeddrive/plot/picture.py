"""A matplotlib figure that displays itself in notebooks without pyplot. Import it only where a figure is drawn."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from io import BytesIO
from typing import Any

from matplotlib.figure import Figure

from feeddrive.language.quantity import DRAWN
from feeddrive.language.table import resolve_texts


class Picture(Figure):
    """A Figure with a picture of itself, at twice the resolution; `savefig` writes it to a file.

    Its texts keep their quantities, and are drawn in the usual units unless `resolve_texts` has read them before.
    """

    def draw(self, renderer: Any) -> None:  # noqa: D102
        with self._readable():
            super().draw(renderer)

    def get_tightbbox(self, *args: Any, **kwargs: Any) -> Any:  # noqa: D102
        with self._readable():
            return super().get_tightbbox(*args, **kwargs)

    @contextmanager
    def _readable(self) -> Generator[None]:
        """Show the texts in the usual units for a while."""
        before = resolve_texts(self, DRAWN)
        try:
            yield
        finally:
            for artist, text in before:
                artist.set_text(text)

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        file = BytesIO()
        self.savefig(file, format="png", dpi=2 * self.dpi)
        width, height = self.get_size_inches() * self.dpi
        return file.getvalue(), {"width": round(width), "height": round(height)}
