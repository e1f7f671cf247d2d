"""A matplotlib figure that displays itself in notebooks without pyplot; imported only where a figure is drawn."""

from io import BytesIO

from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine


class Picture(Figure):
    """A matplotlib Figure with a notebook display at double resolution; `savefig` writes it to a file."""

    def draw(self, renderer: RendererBase) -> None:
        """Draw the figure; if `savefig` draws without output to obtain the layout, only compute the layout."""
        engine = self.get_layout_engine()
        # afterwards a placeholder takes the place of this engine
        if isinstance(engine, ConstrainedLayoutEngine) and self.canvas.is_saving():
            engine.execute(self)
        else:
            super().draw(renderer)

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        file = BytesIO()
        self.savefig(file, format="png", dpi=2 * self.dpi)
        width, height = self.get_size_inches() * self.dpi
        return file.getvalue(), {"width": round(width), "height": round(height)}
