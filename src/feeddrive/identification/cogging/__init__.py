"""Force over position in turns goes in; the harmonics of the cogging come out."""
