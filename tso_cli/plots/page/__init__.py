"""The page of `tso refine --report`: one HTML file that needs nothing else."""

from .write import PageWords, write_page
