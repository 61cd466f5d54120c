"""The studies: each module holds the cases and the tables of a question."""

from pathlib import Path
from typing import Any

import tomllib

WORDS: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
)
"""Command of `tso lab` -> its words; "study": where in `tso_lab` its `Study` is."""
