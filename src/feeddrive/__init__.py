"""feeddrive: the servo loop of a machine-tool feed drive, from a measured log or a machine file to a proven loop.

Public names are loaded on first use, so that `import feeddrive` stays quick.
"""

from __future__ import annotations

__version__ = "0.1.0"
