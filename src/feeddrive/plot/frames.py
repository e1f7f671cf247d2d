"""Results as pandas frames; pandas is an extra and loaded when asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.language.errors import MissingExtraError


def frame(index: Sequence[Any] | np.ndarray, columns: Mapping[str, Any], index_name: str) -> Any:
    """A DataFrame over a named index. Raises MissingExtraError without pandas."""
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("pandas", "pandas", "a DataFrame") from error
    return pandas.DataFrame(dict(columns), index=pandas.Index(index, name=index_name))
