"""The speed of tso and of other ways to do the same work, and what accuracy costs in seconds."""
