"""Tables of numbers in text: where each number stands, and what it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .reading import shown

Integers = NDArray[np.int64]
_BLANK = np.zeros(256, dtype=bool)
_BLANK[[9, 10, 11, 12, 13, 32]] = True
_LONGEST = 100  # characters of a number; without a bound one long word would cost its length for every number
_CHUNK = 1 << 18


class TextTable:
    """The words of ``data[offset:]`` and the lines they stand in; blank lines do not count.

    Attributes
    ----------
    starts, ends : [T] the bytes of ``data`` that each word spans.
    first : [L] index of the first word of each line; counts : [L] words of the line; numbers : [L] its number, from 1.
    """

    def __init__(self, data: bytes, path: Path, offset: int = 0, lines_before: int = 0) -> None:
        self.path = path
        self.data = np.frombuffer(data, dtype=np.uint8)
        body = self.data[offset:]
        blank = np.ones(body.size + 2, dtype=bool)
        blank[1:-1] = _BLANK[body]
        self.starts: Integers = np.flatnonzero(blank[:-1] & ~blank[1:]) + offset
        self.ends: Integers = np.flatnonzero(~blank[:-1] & blank[1:]) + offset
        breaks = np.flatnonzero(body == 10)
        if breaks.size == 0:
            breaks = np.flatnonzero(body == 13)
        line = np.searchsorted(breaks + offset, self.starts)
        self._split(line + 1 + lines_before)

    def _split(self, line: Integers) -> None:
        self.first: Integers = np.flatnonzero(np.diff(line, prepend=-1))
        self.counts: Integers = np.diff(self.first, append=line.size)
        self.numbers: Integers = line[self.first]

    def drop_comments(self) -> None:
        """Forget the lines that start with #."""
        keep = self.data[self.starts[self.first]] != ord("#")
        self.first, self.counts, self.numbers = self.first[keep], self.counts[keep], self.numbers[keep]

    def word(self, index: int) -> str:
        """One word, as text."""
        return self.data[self.starts[index] : self.ends[index]].tobytes().decode("ascii", "backslashreplace")

    def values(self, words: Integers) -> NDArray[np.float64]:
        """The numbers [...] that the words with these indices [...] spell.

        Raises
        ------
        InputError
            A word is not a number.
        """
        flat = words.reshape(-1)
        values = np.empty(flat.size)
        for begin in range(0, flat.size, _CHUNK):
            part = flat[begin : begin + _CHUNK]
            lengths = self.ends[part] - self.starts[part]
            width = int(lengths.max())
            if width > _LONGEST:
                raise self._not_a_number(int(part[lengths.argmax()]))
            steps = np.arange(width)
            where = np.minimum(self.starts[part][:, None] + steps, self.data.size - 1)
            letters = np.where(steps < lengths[:, None], self.data[where], np.uint8(0))
            # numpy would take 1_0 for 10 and drop a NUL at the end of a word.
            wrong = ((letters == ord("_")) | (letters == 0) & (steps < lengths[:, None])).any(axis=1)
            if wrong.any():
                raise self._not_a_number(int(part[wrong.argmax()]))
            try:
                values[begin : begin + _CHUNK] = letters.view(f"S{width}")[:, 0].astype(np.float64)
            except ValueError:
                raise self._not_a_number(next(i for i in part.tolist() if not _is_number(self.word(i)))) from None
        return values.reshape(words.shape)

    def _not_a_number(self, index: int) -> InputError:
        line = self.numbers[np.searchsorted(self.first, index, side="right") - 1]
        return InputError(f"{self.path}: line {line} has {shown(self.word(index))}, expected a number")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
