"""Tables of numbers in text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .reading import shown

Integers = NDArray[np.int64]
_LONGEST = 100  # characters of a number
_BLANK = np.isin(np.arange(256), list(b"\t\n\v\f\r "))


class TextTable:
    """The words of ``data[offset:]``, spanning bytes ``starts`` to ``ends`` [T], and the lines they stand in.

    ``first``, ``counts``, ``numbers`` [L]: of each line that is not blank the index of its first word, its words, its number.
    """

    def __init__(self, data: bytes, path: Path, offset: int = 0, lines_before: int = 0) -> None:
        self.data, self.path = data, path
        body = np.frombuffer(data, np.uint8, offset=offset)
        edges = np.flatnonzero(np.diff(_BLANK[body], prepend=True, append=True)) + offset
        self.starts: Integers = edges[0::2]
        self.ends: Integers = edges[1::2]
        newline = 10 if (body == 10).any() else 13
        line = np.searchsorted(np.flatnonzero(body == newline) + offset, self.starts)
        self.first: Integers = np.flatnonzero(np.diff(line, prepend=-1))
        self.counts: Integers = np.diff(self.first, append=line.size)
        self.numbers: Integers = line[self.first] + 1 + lines_before

    def drop_comments(self) -> None:
        """Forget the lines that start with #."""
        keep = np.frombuffer(self.data, np.uint8)[self.starts[self.first]] != ord("#")
        self.first, self.counts, self.numbers = self.first[keep], self.counts[keep], self.numbers[keep]

    def values(self, words: Integers) -> NDArray[np.float64]:
        """The numbers [...] that the words with these indices [...] spell; InputError where one is not a number."""
        values = np.empty(words.size)
        spans = zip(self.starts[words].ravel().tolist(), self.ends[words].ravel().tolist(), strict=True)
        for k, (start, end) in enumerate(spans):
            word = self.data[start:end]
            try:
                # float() takes 1_0 for 10.
                values[k] = float(word if b"_" not in word and len(word) <= _LONGEST else "")
            except ValueError:
                line = self.numbers[np.searchsorted(self.first, words.flat[k], side="right") - 1]
                text = shown(word.decode("ascii", "backslashreplace"))
                raise InputError(f"{self.path}: line {line} has {text}, expected a number") from None
        return values.reshape(words.shape)
